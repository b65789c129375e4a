"""A demonstration on its way to the target: followed, and not yet done."""

from collections.abc import Sequence
from dataclasses import dataclass

from cei_gym.alignment.judge.report import AlignmentReport
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.transfer.following import Followed


@dataclass(frozen=True)
class Aligned:
    """How the target follows a demonstration.

    Attributes:
        demonstration: of the source.
        scenes: for each of its frames (M, 3 or 6) points that were seen beside it, world, m; empty without clouds.
        followed: the target's joints.
        report: how well it follows.
    """

    demonstration: Demonstration
    scenes: Sequence[Array]
    followed: Followed
    report: AlignmentReport

    @property
    def holds(self) -> bool:
        """Whether the source holds something, so that there is something to correct."""
        grip = self.followed.motion.grip
        return grip is not None and bool(grip.held.any())
