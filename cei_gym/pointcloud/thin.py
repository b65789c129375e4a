"""A fixed number of well-spread points (the paper's policies see clouds of 1024)."""

import fpsample
import numpy as np

from cei_gym.errors import CEIError

_TREE_HEIGHT = 4


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
    height = min(_TREE_HEIGHT, len(points).bit_length() - 1)  # a tree has no more buckets than points
    return points[fpsample.bucket_fps_kdline_sampling(points[:, :3], n, h=height, start_idx=start)]


def first_of_voxels(points: np.ndarray, voxel_m: float) -> np.ndarray:
    """Indices (M,), rising, of the first point in each cell of a grid through the origin.

    Args:
        points: (N, 3) metres, finite, or (N, 6) with colours.
        voxel_m: edge of a cell, metres.
    """
    cells = np.floor(points[:, :3] / voxel_m).astype(np.int64)
    if not len(cells):
        return np.zeros(0, dtype=np.int64)
    cells -= cells.min(axis=0)
    _, y_count, z_count = 1 + cells.max(axis=0)
    # One number a cell: numpy sorts numbers several times as fast as rows.
    _, first = np.unique((cells[:, 0] * y_count + cells[:, 1]) * z_count + cells[:, 2], return_index=True)
    return np.sort(first)
