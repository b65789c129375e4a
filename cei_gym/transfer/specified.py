"""The paper's baseline as a way of following: a person specifies the target's tool and its opening (section VI-A)."""

import numpy as np

from cei_gym.alignment.manual import ManualAlignment
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.arrays import Array
from cei_gym.functional import directional_chamfer_distance


class Specified:
    """Follows by Binary Manual Specification, with the thumb on the side from which the arm follows more closely: a person
    would try both.

    Args:
        problem: the target.
        manual: with the thumb on either side.
        lambda_m: weight of direction in the DCD, m, by which sides and tracks are judged.
    """

    def __init__(
        self, problem: AlignmentProblem, manual: tuple[ManualAlignment, ManualAlignment], lambda_m: float
    ) -> None:
        self._problem, self._both, self._lambda_m = problem, manual, lambda_m
        self._chosen: ManualAlignment | None = None

    @property
    def fitted(self) -> bool:
        """Whether a side has been chosen."""
        return self._chosen is not None

    def fit(self, qpos: Array, T_target_source: Array, motion: Motion) -> None:
        """Choose the side by a demonstration; arguments as for `follow`."""
        self._chosen = min(
            self._both, key=lambda manual: self._track(manual, qpos, T_target_source, motion).objective.mean()
        )

    def follow(self, qpos: Array, T_target_source: Array, motion: Motion) -> Track:
        """Follow a demonstration.

        Args:
            qpos: (T, n) the source's joint positions, rad or m.
            T_target_source: (4, 4) pose of the source's base in the target's.
            motion: of the source's pads, for the track's objective.
        """
        assert self._chosen is not None
        return self._track(self._chosen, qpos, T_target_source, motion)

    def _track(self, manual: ManualAlignment, qpos: Array, T_target_source: Array, motion: Motion) -> Track:
        u = manual.track(qpos, T_target_source)
        objective = [
            directional_chamfer_distance(points, normals, *self._problem.place(each), self._lambda_m)
            for points, normals, each in zip(motion.points_base, motion.normals_base, u, strict=True)
        ]
        return Track(u, np.array(objective), np.zeros(len(u), int))
