"""Numbers as a person would write them into a YAML."""

import numpy as np

from cei_gym.arrays import Array

_DIGITS = 3


def rounded(value: float) -> float:
    """A number in few digits; 0 has no sign."""
    return round(float(value), _DIGITS) + 0.0


def inside(pose: Array, lower: Array, upper: Array) -> list[float]:
    """Joint positions in few digits that are within limits."""
    step = 10.0**-_DIGITS
    low, high = np.ceil(lower / step - 1e-6) * step, np.floor(upper / step + 1e-6) * step
    return [rounded(v) for v in np.where(low <= high, np.clip(np.round(pose / step) * step, low, high), pose)]
