"""What values of a source should be like."""

from collections.abc import Sequence

import numpy as np

from cei_gym.arrays import Array
from cei_gym.errors import CEIError

LEAST_FRAMES = 12


def likely_unit(unit: str, extent: float) -> str:
    """What a joint's column may be whose largest number is far beyond the joint's limits, and what a joint map would say."""
    if unit == "m":
        return "millimetres or percent; convert to m, or say so in a joint map, by unit: mm, or unit: normalised, range: [0, 100]"
    if extent > 400:
        return "servo ticks; a joint map says so by unit: ticks, range: [at the lower limit, at the upper limit]"
    if extent <= 101:
        return "degrees or LeRobot's -100 to 100; a joint map says which, by unit: deg or unit: normalised, range: [-100, 100]"
    return "degrees; convert to rad, or say so in a joint map, by unit: deg"


def check_finite(values: Array, where: str, key: str, names: Sequence[str]) -> None:
    """Refuse (T, N) values that are no numbers, with the first such frame and column.

    Raises:
        CEIError: there is one.
    """
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        frame, column = bad[0]
        raise CEIError(
            f"{where}, frame {frame}, {names[column]}: {key} is {values[frame, column]}; "
            "leave the episode out with --episodes or record it again."
        )


def check_cloud(cloud: Array, frames: int, where: str) -> Array:
    """Checked (T, P, 3 or 6) float32 points, colours from 0-255 to [0, 1] where that is what they are.

    Raises:
        CEIError: it is of another shape.
    """
    if cloud.ndim != 3 or len(cloud) != frames or cloud.shape[2] not in (3, 6) or cloud.dtype.kind not in "fiu":
        raise CEIError(
            f"{where}: point clouds should be ({frames}, points, 3 or 6) numbers, not {cloud.shape} {cloud.dtype}."
        )
    cloud = cloud.astype(np.float32)
    if cloud.shape[2] == 6 and np.nanmax(cloud[..., 3:], initial=0.0) > 1:
        cloud[..., 3:] /= 255
    return cloud
