"""One frame's cloud with one robot taken out and another put in (the paper's section IV-C)."""

import numpy as np

from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud.crop import crop
from cei_gym.pointcloud.mask import RobotMask
from cei_gym.pointcloud.sample import SurfaceSampler
from cei_gym.pointcloud.thin import farthest_point_sample


class CloudSynthesiser:
    """Crop, mask the source, add the target, thin: the same for every frame.

    Args:
        source: the robot in the recorded cloud.
        target: the robot to put in.
        tau_m: points within this distance of the source's surface are removed (the paper's 5 mm).
        robot_points: points sampled over the whole target before cropping.
        cloud_points: points of the result (the paper's 1024).
        seed: of sampling and thinning.
    """

    def __init__(
        self,
        source: Embodiment,
        target: Embodiment,
        tau_m: float,
        robot_points: int,
        cloud_points: int,
        seed: int,
    ) -> None:
        self._source, self._target = KinematicTree(source), KinematicTree(target)
        self._mask = RobotMask(visual_link_meshes(source.model), tau_m)
        self._sample = SurfaceSampler(visual_link_meshes(target.model), robot_points, seed)
        self._cloud_points, self._seed = cloud_points, seed

    def scene(
        self,
        points_world: np.ndarray,
        workspace_world: np.ndarray,
        source_qpos: np.ndarray,
        T_world_source: np.ndarray,
    ) -> np.ndarray:
        """One frame's recorded points without the source robot.

        Args:
            points_world: (N, 3) recorded points, m; points that are not finite are dropped.
            workspace_world: (2, 3) box, m.
            source_qpos: joint positions of the source at this frame.
            T_world_source: (4, 4) pose of its base.

        Returns:
            (M, 3) m, world.
        """
        scene = points_world[crop(points_world, workspace_world)]
        return scene[~self._mask(scene, T_world_source @ self._source.forward(source_qpos))]

    def __call__(
        self,
        scene_world: np.ndarray,
        workspace_world: np.ndarray,
        target_qpos: np.ndarray,
        T_world_target: np.ndarray,
    ) -> np.ndarray:
        """The target's cloud of one frame.

        Args:
            scene_world: (M, 3) what `scene` returned.
            workspace_world: (2, 3) box, m.
            target_qpos: joint positions of the target at this frame.
            T_world_target: (4, 4) pose of its base.

        Returns:
            (cloud_points, 3) float32, m, world.
        """
        robot = self._sample(T_world_target @ self._target.forward(target_qpos))
        robot = robot[crop(robot, workspace_world)]
        return farthest_point_sample(np.concatenate([scene_world, robot]), self._cloud_points, self._seed)
