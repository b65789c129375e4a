"""Points on the robot's surface (paper, section IV-C: "sampling points across the robot's mesh")."""

from collections.abc import Sequence
from typing import cast

import numpy as np
import trimesh
from trimesh.visual import ColorVisuals

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.errors import CEIError


class SurfaceSampler:
    """Points drawn once, uniformly over the area of all links, that then move with their links.

    Drawing once keeps the cloud steady from frame to frame, and costs nothing a frame.

    Attributes:
        link_ids: (n,) int64, the link of each point.
        points_link: (n, 3) float64, the points in the frames of their links, metres.
        colours: (n, 3) float64, the colours of their faces in [0, 1].
    """

    def __init__(self, link_meshes: Sequence[trimesh.Trimesh | None], n_points: int, seed: int = 0) -> None:
        """
        Args:
            link_meshes: L meshes in link frames, metres; None for a link without a surface.
            n_points: how many points.
            seed: of the draw.

        Raises:
            CEIError: no link has a surface.
        """
        meshes = {link: mesh for link, mesh in enumerate(link_meshes) if mesh is not None and mesh.area > 0}
        if not meshes:
            raise CEIError("no link of the robot has a mesh to sample points on.")
        self._links = len(link_meshes)
        whole = trimesh.util.concatenate(
            [trimesh.Trimesh(mesh.vertices, mesh.faces, process=False) for mesh in meshes.values()]
        )
        points_link, face = trimesh.sample.sample_surface(whole, n_points, seed=seed)[:2]
        link_of_face = np.repeat(list(meshes), [len(mesh.faces) for mesh in meshes.values()])
        self.points_link = np.asarray(points_link, dtype=np.float64)
        self.link_ids = link_of_face[face]
        colours = np.concatenate([cast(ColorVisuals, mesh.visual).face_colors[:, :3] for mesh in meshes.values()])
        self.colours = colours[face] / 255

    def __call__(self, T_world_links: Array) -> Array:
        """(n, 3) float64 points in the world, metres, for poses (L, 4, 4) of the links.

        Raises:
            CEIError: there is not one pose for each link.
        """
        return self.within(T_world_links, np.array([[-np.inf] * 3, [np.inf] * 3]), len(self.points_link))[0]

    def within(self, T_world_links: Array, box_world: Array, most: int) -> tuple[Array, Array]:
        """The first points in a box; drawn in random order, they are as uniform as all that are in it.

        Args:
            T_world_links: (L, 4, 4) poses of the links.
            box_world: (2, 3) lower and upper corner, metres, its faces included.
            most: how many are enough.

        Returns:
            (m, 3) float64 points in the world, metres, and (m,) which of the sampler's they are; m <= most.

        Raises:
            CEIError: there is not one pose for each link.
        """
        T_world_links = np.asarray(T_world_links, dtype=np.float64)
        if T_world_links.shape != (self._links, 4, 4):
            raise CEIError(f"the sampler has {self._links} links, but poses of shape {T_world_links.shape}.")
        most = min(most, len(self.points_link))
        points_world, which = np.empty((most, 3)), np.empty(most, np.int64)
        found = _move(
            self.points_link, self.link_ids, T_world_links, np.asarray(box_world, np.float64), points_world, which
        )
        return points_world[:found], which[:found]


@njit(cache=True, nogil=True)
def _move(points_link, link_ids, T_world_links, box, points_world, which):
    """Fills points_world and which until they are full; returns how many there are."""
    found = 0
    for n in range(len(points_link)):
        if found == len(which):
            break
        T = T_world_links[link_ids[n]]
        x, y, z = points_link[n]
        inside = True
        for axis in range(3):
            moved = T[axis, 0] * x + T[axis, 1] * y + T[axis, 2] * z + T[axis, 3]
            inside &= box[0, axis] <= moved <= box[1, axis]
            points_world[found, axis] = moved
        if inside:
            which[found] = n
            found += 1
    return found
