"""What is computed at once on a device: frames of sources, and a target at many configurations."""

from typing import NamedTuple

from torch import Tensor


class Sources(NamedTuple):
    """Frames of sources about their centroids, in the target's base frame.

    Attributes:
        origin: (F, 3) centroids, m.
        pairs: (F, 6, N) points minus origin, m, and unit normals.
        height: (F,) of the support surface, m.
        obstacles: (F, P, 3) points on objects minus origin, m.
    """

    origin: Tensor
    pairs: Tensor
    height: Tensor
    obstacles: Tensor


class BatchPose(NamedTuple):
    """B problems, each at one configuration, and what its matches amount to.

    Attributes:
        frames: (B, n + 1, 4, 4) joint frames about the source's centroid; the last is the base.
        pairs: (B, 6, N') target pairs.
        pull: (B, 8, N') of each target pair: force, summed lambda weight times source normals, and the sums of
            weight / d and of lambda weight.
        lacking: (B, C) clearance that links lack, m; 0 where they have enough.
        wrench: (B, C, 6) how links move out, linear then about the centroid.
    """

    frames: Tensor
    pairs: Tensor
    pull: Tensor
    lacking: Tensor
    wrench: Tensor

    def take(self, rows: Tensor) -> "BatchPose":
        """Some of the problems, or some several times."""
        return BatchPose(*(x[rows] for x in self))
