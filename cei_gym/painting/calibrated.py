"""Whether a calibration is a camera's: what moves in its pictures should be where joints say that the robot is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cei_gym.arrays import Array
from cei_gym.painting.behind import Plate

_OTHER = 24  # of 255: more than noise and compression


@dataclass(frozen=True)
class Agreement:
    """What samples of a camera's pictures show.

    Attributes:
        covered: mean share of a picture where the robot should be.
        explained: of what differs from what is behind, the share where the robot should be; what it carries, shadows and a little
            motion beside it are the rest.
        filled: of where the robot should be, the share that differs from what is behind: the rest is of the background's colour, or is no robot.
        still: median share of what is not the robot that looks as it mostly does: little where a camera moves.
    """

    covered: float
    explained: float
    filled: float
    still: float


def agreement(pictures: Array, covered: Sequence[Array], plate: Plate) -> Agreement:
    """Compare (N, H, W, 3) uint8 pictures with what is behind the robot, by the pixels that it should cover in each."""
    shares: list[float] = []
    inside = outside = known = 0
    for picture, pixels in zip(pictures, covered, strict=True):
        other = np.abs(picture.astype(np.int16) - plate.picture).max(axis=-1) > _OTHER
        robot = np.zeros(other.shape, bool)
        robot.ravel()[pixels] = True
        inside += int((other & robot & plate.known).sum())
        known += int((robot & plate.known).sum())
        outside += int((other & ~robot).sum())
        shares.append(float((~other)[~robot].mean()) if not robot.all() else 0.0)
    size = pictures[0, ..., 0].size
    moved = inside + outside
    return Agreement(
        float(np.mean([len(pixels) / size for pixels in covered])),
        inside / moved if moved else 0.0,
        inside / known if known else 0.0,
        float(np.median(shares)),
    )
