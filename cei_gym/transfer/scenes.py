"""What cameras saw of a demonstration: without the source, as obstacles, and with the target (section IV-C)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cei_gym.alignment.problem import Motion
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError
from cei_gym.pointcloud import CloudSynthesiser, crop, frame_points
from cei_gym.pointcloud.attached import attached
from cei_gym.pointcloud.isolated import isolated
from cei_gym.pointcloud.remember import remember

_ABOVE_SUPPORT_M = 0.005
_NEAR_HAND_M = 0.2  # what is farther from the source's pads is no obstacle
_COMPANY_M = 0.02  # within which a point of an object has some others; what has fewer is noise
_COMPANY = 5  # so many; with three, of a cloud of 30 % outliers some 20 points a frame pass
_CARRIED_M = 0.005


class Scenes:
    """The scenes of demonstrations.

    Args:
        synthesiser: takes the source out of clouds, and puts the target in.
    """

    def __init__(self, synthesiser: CloudSynthesiser) -> None:
        self._synthesiser = synthesiser
        self.options = synthesiser.options

    def without_source(self, demonstration: Demonstration) -> list[Array]:
        """For each frame the recorded points (M, 3 or 6) without the source robot, world, objects displaced if they are to be;
        empty where nothing was recorded."""
        d = demonstration
        scenes: list[Array] = []
        for t, qpos in enumerate(d.qpos):
            points = self._recorded(d, t)
            if points is None:
                return []
            points = self._synthesiser.remove(points, d.scene, qpos)
            if d.displacement is not None:
                points = d.displacement.move(points, t)
                points = points[crop(points, d.scene.workspace_world)]
            scenes.append(points)
        return scenes

    def obstacles(
        self,
        demonstration: Demonstration,
        scenes: Sequence[Array],
        motion: Motion,
        T_world_target: Array,
        hand: Array,
    ) -> tuple[list[Array], float]:
        """What stands on the support surface near the hand, target's base frame.

        Args:
            demonstration: of the source.
            scenes: as of `without_source`.
            motion: of its pads, with its grip.
            T_world_target: (4, 4) pose of the target's base.
            hand: (T, 4, 4) pose of the source's hand in the target's base frame.

        Returns:
            For each frame (P, 3) points on it, m; and how many points a frame, in the mean, the hand has with it all the time.
        """
        T_base_world = np.linalg.inv(T_world_target)
        floor = demonstration.scene.support_z_m + _ABOVE_SUPPORT_M
        above = [s[s[:, 2] > floor, :3] for s in scenes]
        above = [s[~isolated(s, _COMPANY_M, _COMPANY)] for s in above]
        objects = [s @ T_base_world[:3, :3].T + T_base_world[:3, 3] for s in above]
        nothing = np.zeros(len(scenes), bool)
        held = nothing if motion.grip is None else motion.grip.held
        moved = nothing if motion.grip is None else motion.grip.carried_m > _CARRIED_M
        middle = motion.points_base.mean(axis=1)
        tool = attached(objects, hand, middle, ~held, _NEAR_HAND_M)
        objects = [points[~its] for points, its in zip(objects, tool, strict=True)]
        return remember(objects, middle, moved, _NEAR_HAND_M), float(np.mean([its.sum() for its in tool]))

    def clouds(
        self, demonstration: Demonstration, scenes: Sequence[Array], qpos: Array, T_world_target: Array
    ) -> Array | None:
        """(T, K, 3 or 6) clouds, world, with the target at (T, n') joint positions; None where nothing was recorded.

        Raises:
            CEIError: the source is to stay in the clouds, and the demonstration is displaced.
        """
        if not scenes:
            return None
        if not self.options.swap:
            if demonstration.displacement is not None:
                raise CEIError(
                    "clouds.swap=false keeps the source in the clouds, which cannot be displaced with objects."
                )
            recorded = (self._recorded(demonstration, t) for t in range(len(demonstration)))
            return np.stack([self._synthesiser.keep(p, demonstration.scene) for p in recorded if p is not None])
        scene = replace(demonstration.scene, T_world_base=T_world_target)
        return np.stack([self._synthesiser.add(s, scene, q) for s, q in zip(scenes, qpos, strict=True)])

    def _recorded(self, d: Demonstration, t: int) -> Array | None:
        """(N, 3 or 6) a frame's recorded points, world; None where nothing was recorded."""
        depth_m, rgb = ({name: images[t] for name, images in each.items()} for each in (d.depth_m, d.rgb))
        cloud = None if d.point_cloud_world is None else d.point_cloud_world[t]
        return frame_points(d.scene, depth_m, rgb, cloud, self.options.colours)
