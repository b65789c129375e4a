"""Which points belong to the robot (paper, section IV-C: "mask any point within tau of the source robot").

The paper measures the distance to points sampled on the robot. A few thousand of them leave nine in ten of
the robot's points in the cloud (a Panda has 3.6 m^2 of visual surface), so here the distance is to the
triangles, which is the limit of ever denser samples.
"""

from collections.abc import Sequence

import numpy as np
import trimesh

from cei_gym.arrays import Array
from cei_gym.errors import CEIError
from cei_gym.pointcloud.grid import build, mark_near


class RobotMask:
    """Marks points within tau of the surface of any link; exact but for rounding (below a micrometre)."""

    def __init__(self, link_meshes: Sequence[trimesh.Trimesh | None], tau_m: float = 0.005) -> None:
        """
        Args:
            link_meshes: L meshes in link frames, metres; None for a link without a surface.
            tau_m: the paper's threshold.

        Raises:
            CEIError: tau is not positive.
        """
        if not 0 < tau_m < np.inf:
            raise CEIError(f"the mask's threshold tau must be positive, not {tau_m} m.")
        self.tau_m = tau_m
        self._links = len(link_meshes)
        self._grid = build([np.empty((0, 3, 3)) if mesh is None else mesh.triangles for mesh in link_meshes], tau_m)

    def __call__(self, points_world: Array, T_world_links: Array) -> Array:
        """Which points are on the robot.

        Args:
            points_world: (N, 3) metres; points that are not finite are on no robot.
            T_world_links: (L, 4, 4) poses of the links.

        Returns:
            (N,) bool.

        Raises:
            CEIError: there is not one pose for each link.
        """
        T_world_links = np.asarray(T_world_links, dtype=np.float64)
        if T_world_links.shape != (self._links, 4, 4):
            raise CEIError(f"the mask has {self._links} links, but poses of shape {T_world_links.shape}.")
        R_link_world = np.ascontiguousarray(T_world_links[:, :3, :3].transpose(0, 2, 1))
        p_link_world = -np.einsum("lij,lj->li", R_link_world, T_world_links[:, :3, 3])
        points_world = np.ascontiguousarray(points_world, dtype=np.float64)
        near = np.zeros(len(points_world), dtype=bool)
        mark_near(self._grid, points_world, R_link_world, p_link_world, self.tau_m, near)
        return near
