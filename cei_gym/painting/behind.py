"""What is behind a robot in a picture: what other frames of a fixed camera show there.

Robots cover a tenth of a picture, so masks are (K,) indices of pixels, row by row: an episode's would else be as large as its video.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cei_gym.arrays import Array


@dataclass(frozen=True)
class Change:
    """Where a picture shows something else from a frame on, such as an object that has been taken away or put down.

    Attributes:
        frame: the first with the new.
        pixels: (K,) which.
    """

    frame: int
    pixels: Array


@dataclass(frozen=True)
class Plate:
    """A camera's view without the robot, from several episodes.

    Attributes:
        picture: (H, W, 3) uint8.
        known: (H, W) bool, where some frame shows it.
    """

    picture: Array
    known: Array

    @classmethod
    def median(cls, pictures: Array, covered: Sequence[Array]) -> "Plate":
        """Of (N, H, W, 3) uint8 pictures, each pixel's median over those in which it is not among the `covered`."""
        hidden = np.zeros(pictures.shape[:3], bool)
        for mask, pixels in zip(hidden, covered, strict=True):
            mask.ravel()[pixels] = True
        plate = np.zeros(pictures.shape[1:], np.uint8)
        for row in range(pictures.shape[1]):  # in strips: memory stays small
            shown = np.ma.array(pictures[:, row], mask=np.repeat(hidden[:, row, :, None], 3, axis=-1))
            plate[row] = np.ma.median(shown, axis=0).filled(0)
        return cls(plate, np.logical_not(hidden.all(axis=0)))


def nearest_in_time(
    size: int, robot: Sequence[Array], covered: Sequence[Array], changes: Sequence[Change]
) -> list[Array]:
    """For each frame and pixel of the robot, the nearest frame that shows what is behind, and in which nothing has changed there.

    Args:
        size: pixels of a picture.
        robot: of each frame, the pixels to uncover.
        covered: of each frame, those that show nothing of what is behind: the robot's, and those of what it carries.
        changes: across which nothing is taken.

    Returns:
        Of each frame, (K,) frame for each of the robot's pixels, -1 where there is none.
    """
    frames = range(len(robot))
    before = [seen.copy() for seen in _last_seen(size, robot, covered, frames, changes, after=False)]
    nearest: list[Array] = [np.empty(0, np.int32)] * len(robot)
    backwards = _last_seen(size, robot, covered, reversed(frames), changes, after=True)
    for t, after in zip(reversed(frames), backwards, strict=True):
        earlier = (after < 0) | ((before[t] >= 0) & (t - before[t] <= after - t))
        nearest[t] = np.where(earlier, before[t], after)
    return nearest


def _last_seen(
    size: int,
    robot: Sequence[Array],
    covered: Sequence[Array],
    frames: Iterable[int],
    changes: Sequence[Change],
    after: bool,
) -> Iterable[Array]:
    """Of each frame, in their order, (K,) the last before it that shows what is behind the robot's pixels; -1 where none does."""
    last = np.full(size, -1, np.int32)
    for t in frames:
        for change in changes:  # it lies between this frame and the last
            if change.frame == t + after:
                last[change.pixels] = -1
        kept = last[covered[t]]
        last[:] = t
        last[covered[t]] = kept
        yield last[robot[t]]


def shown(pictures: Array, covered: Sequence[Array], frames: Iterable[int]) -> tuple[Array, Array]:
    """What the first of some frames that shows it has at each pixel.

    Args:
        pictures: (T, H, W, 3) uint8.
        covered: of each frame, pixels that show nothing of what is behind.
        frames: in the order in which they are asked.

    Returns:
        (H, W, 3) uint8, and (H, W) bool, where one shows it.
    """
    picture, unknown = np.zeros(pictures.shape[1:], np.uint8), np.ones(pictures.shape[1:3], bool)
    for t in frames:
        new = unknown.copy()
        new.ravel()[covered[t]] = False
        picture[new] = pictures[t][new]
        unknown &= ~new
        if not unknown.any():
            break
    return picture, ~unknown
