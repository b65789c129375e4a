"""Which points of a robot the scene's cameras would see: real clouds show no far sides."""

from collections.abc import Sequence

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment.meshes import visual_geoms
from cei_gym.rendering import DepthCamera, project

_BEHIND_M = 0.01  # a surface leans within a pixel; a point this far behind it is hidden


class SeenPoints:
    """Tells the points of a robot that some camera sees from those behind the robot itself or behind the scene.

    Args:
        model: of the robot.
        cameras: in the world.
    """

    def __init__(self, model: mujoco.MjModel, cameras: Sequence[Camera]) -> None:
        self._camera = DepthCamera(model, cameras, geoms=visual_geoms(model))

    def __call__(self, points_world: Array, T_world_links: Array, scene_world: Array) -> Array:
        """Which points (N, 3) are seen.

        Args:
            points_world: on the robot's surface, metres.
            T_world_links: (L, 4, 4) poses of its links.
            scene_world: (M, 3) points of everything else, metres; each hides what is behind it within its pixel.

        Returns:
            (N,) bool.
        """
        seen = np.zeros(len(points_world), dtype=bool)
        images = self._camera.render_at(T_world_links)
        for camera in self._camera.cameras:
            nearest_m = images[camera.name][0]
            nearest_m[nearest_m == 0] = np.inf
            pixel, depth_m = project(scene_world, camera)
            shown = pixel[:, 0] >= 0
            np.minimum.at(nearest_m, tuple(pixel[shown].T), depth_m[shown].astype(np.float32))
            pixel, depth_m = project(points_world, camera)
            shown = pixel[:, 0] >= 0
            seen[shown] |= depth_m[shown] <= nearest_m[tuple(pixel[shown].T)] + _BEHIND_M
        return seen
