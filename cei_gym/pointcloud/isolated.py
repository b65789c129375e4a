"""Points without company: flying pixels, outliers, and what a mask has missed here and there."""

import numpy as np
from scipy.spatial import KDTree

from cei_gym.arrays import Array


def isolated(points: Array, radius_m: float, neighbours: int = 3) -> Array:
    """Which points have fewer than so many others within a radius.

    Args:
        points: (N, 3) metres, finite.
        radius_m: how near is near.
        neighbours: how many others a point of a surface has at least.

    Returns:
        (N,) bool.
    """
    if len(points) == 0:
        return np.zeros(0, dtype=bool)
    return KDTree(points).query_ball_point(points, radius_m, return_length=True) <= neighbours  # itself counts
