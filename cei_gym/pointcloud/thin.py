"""A fixed number of well-spread points (the paper's policies see clouds of 1024)."""

import fpsample
import numpy as np
from numba import njit

from cei_gym.errors import CEIError

_LARGE = 6000  # from here a higher tree is quicker, by about a tenth


def farthest_point_sample(points: np.ndarray, n: int = 1024, seed: int = 0) -> np.ndarray:
    """Greedy farthest points from a seeded start; the same input and seed give the same output.

    Args:
        points: (N, 3) metres, or (N, 6) with colours, which have no say in what is far; finite.
        n: how many to keep.
        seed: of the first point, and of the padding.

    Returns:
        (n, 3 or 6) float32. When N < n: all points, then seeded repeats of them. When N == 0: zeros.

    Raises:
        CEIError: a point is not finite.
    """
    points = np.ascontiguousarray(points, dtype=np.float32)
    if not np.isfinite(points).all():
        raise CEIError("cannot thin a cloud with points that are not finite; crop it first.")
    if len(points) == 0:
        return np.zeros((n, points.shape[1]), dtype=np.float32)
    random = np.random.default_rng(seed)
    if len(points) <= n:
        return np.concatenate([points, points[random.integers(len(points), size=n - len(points))]])
    start = int(random.integers(len(points)))
    height = min(
        5 if len(points) > _LARGE else 4, len(points).bit_length() - 1
    )  # a tree has no more buckets than points
    return points[fpsample.bucket_fps_kdline_sampling(points[:, :3], n, h=height, start_idx=start)]


def first_of_voxels(points: np.ndarray, voxel_m: float) -> np.ndarray:
    """Indices (M,), rising, of the first point in each cell of a grid through the origin.

    Args:
        points: (N, 3) metres, finite, or (N, 6) with colours.
        voxel_m: edge of a cell, metres.
    """
    slots = np.full(1 << (2 * len(points)).bit_length(), -1)
    return np.flatnonzero(_is_first(np.floor(points[:, :3] / voxel_m).astype(np.int64), slots))


@njit(cache=True, nogil=True)
def _is_first(cells, slots):
    """(N,) whether no earlier row of cells (N, 3) is the same; slots: a hash table, -1, a power of two long, of rows."""
    first = np.zeros(len(cells), dtype=np.bool_)
    for n in range(len(cells)):
        x, y, z = cells[n]
        slot = (x * 73856093 ^ y * 19349663 ^ z * 83492791) & (len(slots) - 1)
        while slots[slot] >= 0:
            other = slots[slot]
            if cells[other, 0] == x and cells[other, 1] == y and cells[other, 2] == z:
                break
            slot = (slot + 1) & (len(slots) - 1)
        else:
            slots[slot], first[n] = n, True
    return first
