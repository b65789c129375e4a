"""A depth and segmentation camera over the visual geoms of a MuJoCo model."""

from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.rendering.rasteriser import rasterise
from cei_gym.rendering.shapes import geom_scale
from cei_gym.rendering.triangles import collect, visible_geoms

NEAR_M = 0.01


class DepthCamera:
    """Renders depth and geom ids from fixed viewpoints.

    Sizes of primitive geoms are read at every frame; meshes, groups and transparency when the camera is made.
    A new model (as after a hard reset) needs a new camera.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        cameras: Sequence[Camera],
        groups: Sequence[int] = (1,),
        cluster_m: float = 0.001,
        geoms: Array | None = None,
    ) -> None:
        """
        Args:
            model: the scene.
            cameras: viewpoints, in the world.
            groups: geom groups to draw; robosuite's visual geoms are in group 1.
            cluster_m: meshes are simplified to this detail, metres; 0 keeps them whole.
            geoms: (ngeom,) bool, what to draw instead of `groups`.

        Raises:
            CEIError: no geom is in these groups, or one cannot be drawn.
        """
        self.cameras = tuple(cameras)
        self._model = model
        self._triangles = collect(model, visible_geoms(model, groups) if geoms is None else geoms, cluster_m)

    def render(self, data: mujoco.MjData) -> dict[str, tuple[Array, Array]]:
        """Images of the scene as `data` has it (after `mj_forward` or `mj_kinematics`).

        Returns:
            camera name to depth (H, W) float32, metres along the optical axis, and geom id (H, W) int32;
            0 and -1 where nothing is.
        """
        geom_id = self._triangles.geom_id
        return self._render(data.geom_xmat[geom_id].reshape(-1, 3, 3), data.geom_xpos[geom_id])

    def render_at(
        self, T_world_bodies: Array, cameras: Sequence[Camera] | None = None
    ) -> dict[str, tuple[Array, Array]]:
        """The same images with the model's bodies at the poses (nbody, 4, 4), by other cameras if they are given."""
        geom_id = self._triangles.geom_id
        T_world_body = T_world_bodies[self._model.geom_bodyid[geom_id]]
        R_world_body = T_world_body[:, :3, :3]
        p_world_geom = np.einsum("gij,gj->gi", R_world_body, self._model.geom_pos[geom_id]) + T_world_body[:, :3, 3]
        R_body_geom = Rotation.from_quat(self._model.geom_quat[geom_id], scalar_first=True).as_matrix()
        return self._render(R_world_body @ R_body_geom, p_world_geom, cameras)

    def _render(
        self, R_world_geom: Array, p_world_geom: Array, cameras: Sequence[Camera] | None = None
    ) -> dict[str, tuple[Array, Array]]:
        triangles = self._triangles
        scale, shift = geom_scale(self._model, triangles.geom_id)
        images = {}
        for camera in self.cameras if cameras is None else cameras:
            R, p = camera.T_world_camera[:3, :3], camera.T_world_camera[:3, 3]
            inverse_depth = np.zeros((camera.height, camera.width))
            id_image = np.full(inverse_depth.shape, -1, dtype=np.int32)
            rasterise(
                triangles.vertices,
                triangles.caps,
                triangles.faces,
                triangles.vertex_range,
                triangles.face_range,
                triangles.one_sided,
                triangles.geom_id,
                scale,
                shift,
                np.ascontiguousarray(R.T @ R_world_geom),
                np.ascontiguousarray((p_world_geom - p) @ R),
                (camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]),
                NEAR_M,
                inverse_depth,
                id_image,
            )
            depth_m = np.divide(1.0, inverse_depth, where=id_image >= 0, out=np.zeros_like(inverse_depth))
            images[camera.name] = depth_m.astype(np.float32), id_image
        return images
