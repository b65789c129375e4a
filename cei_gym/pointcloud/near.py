"""Whether two clouds come near each other."""

import numpy as np
from scipy.spatial import KDTree

from cei_gym.arrays import Array


def any_near(points: Array, others: Array, within_m: float) -> bool:
    """Whether any of the points (N, 3) is within a distance of any of the others (M, 3); m, finite."""
    if not len(points) or not len(others):
        return False
    return bool(np.isfinite(KDTree(others).query(points, distance_upper_bound=within_m)[0]).any())
