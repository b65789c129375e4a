"""One frame's cloud with one robot taken out and another put in (the paper's section IV-C)."""

import numpy as np

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera, Scene
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud.crop import crop
from cei_gym.pointcloud.isolated import isolated
from cei_gym.pointcloud.mask import RobotMask
from cei_gym.pointcloud.options import CloudOptions
from cei_gym.pointcloud.sample import SurfaceSampler
from cei_gym.pointcloud.seen import SeenPoints
from cei_gym.pointcloud.thin import farthest_point_sample, first_of_voxels, share_sample

_CANDIDATES = (
    2  # a point: more spread hardly better (mean distance to the cloud 5.0 mm, with four 4.8), and thin slower
)


class CloudSynthesiser:
    """Crop, mask the source, add the target, thin: the same for every frame, in the converter and at inference.

    Args:
        source: the robot in the recorded cloud.
        target: the robot to put in.
        options: of the result.
    """

    def __init__(self, source: Embodiment, target: Embodiment, options: CloudOptions | None = None) -> None:
        self.options = o = options or CloudOptions()
        self._source, self._target = KinematicTree(source), KinematicTree(target)
        self._target_model = target.model
        self._mask = RobotMask(visual_link_meshes(source.model), o.tau_m)
        self._sample = SurfaceSampler(visual_link_meshes(target.model), o.robot_points, o.seed)
        self._seen: tuple[tuple[Camera, ...], SeenPoints] | None = None

    def remove(self, points_world: Array, scene: Scene, qpos: Array) -> Array:
        """One frame's recorded points without the source robot.

        Args:
            points_world: (N, 3) recorded points, m, or (N, 6) with colours in [0, 1]; those not finite are dropped.
            scene: the source's base, and the workspace that is kept.
            qpos: joint positions of the source at this frame.

        Returns:
            (M, 3 or 6), m, world.

        Raises:
            CEIError: points have neither 3 nor 6 entries.
        """
        if points_world.ndim != 2 or points_world.shape[1] not in (3, 6):
            raise CEIError(
                f"a cloud is (N, 3): x, y, z in m, or (N, 6): and r, g, b in [0, 1]; not {points_world.shape}."
            )
        points = self._cropped(points_world, scene)
        points = points[~self._mask(points[:, :3], scene.T_world_base @ self._source.forward(qpos))]
        if self.options.outlier_m:
            points = points[~isolated(points[:, :3], self.options.outlier_m)]
        return points

    def keep(self, points_world: Array, scene: Scene) -> Array:
        """One frame's cloud with the robot that was recorded: cropped and thinned alone (see `CloudOptions.swap`).

        Args:
            points_world: (N, 3 or 6) recorded points, m.
            scene: the workspace that is kept.

        Returns:
            (options.points, 3 or 6) float32, m, world.
        """
        return farthest_point_sample(self._cropped(points_world, scene), self.options.points, self.options.seed)

    def add(self, points_world: Array, scene: Scene, qpos: Array) -> Array:
        """The target's cloud of one frame.

        Args:
            points_world: (M, 3 or 6) what `remove` returned.
            scene: the target's base, the workspace that is kept, and the cameras that decide what is seen, if asked for.
            qpos: joint positions of the target at this frame.

        Returns:
            (options.points, 3 or 6) float32, m, world.

        Raises:
            CEIError: only seen points are wanted, but the scene has no camera.
        """
        o = self.options
        T_world_links = scene.T_world_base @ self._target.forward(qpos)
        most = _CANDIDATES * o.points
        robot, which = self._sample.within(
            T_world_links, scene.workspace_world, o.robot_points if o.seen_only else most
        )
        if o.seen_only:
            seen = np.flatnonzero(self._seen_by(scene.cameras)(robot, T_world_links, points_world[:, :3]))[:most]
            robot, which = robot[seen], which[seen]
        if points_world.shape[1] == 6:
            robot = np.concatenate([robot, self._sample.colours[which]], axis=1)
        points, others = np.concatenate([points_world, robot]), len(points_world)
        if o.voxel_m:
            kept = first_of_voxels(points, o.voxel_m)
            points, others = points[kept], int((kept < others).sum())
        if o.robot_share is not None:
            return share_sample(points[:others], points[others:], o.robot_share, o.points, o.seed)
        return farthest_point_sample(points, o.points, o.seed)

    def _cropped(self, points_world: Array, scene: Scene) -> Array:
        points = points_world if self.options.colours else points_world[:, :3]
        return points[crop(points, scene.workspace_world)]

    def _seen_by(self, cameras: tuple[Camera, ...]) -> SeenPoints:
        if not cameras:
            raise CEIError("clouds.seen_only asks what cameras see, but the scene has none; calibrate one.")
        if self._seen is None or self._seen[0] is not cameras:
            self._seen = cameras, SeenPoints(self._target_model, cameras)
        return self._seen[1]
