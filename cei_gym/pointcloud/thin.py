"""A fixed number of well-spread points (the paper's policies see clouds of 1024)."""

import numpy as np

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.errors import CEIError

_BLOCK = 128


def farthest_point_sample(points: Array, n: int = 1024, seed: int = 0) -> Array:
    """Greedy farthest points from a seeded start; the same input and seed give the same output.

    Args:
        points: (N, 3) metres, or (N, 6) with colours, which have no say in what is far; finite.
        n: how many to keep.
        seed: of the first point, and of the padding.

    Returns:
        (n, 3 or 6) float32, the first so many of which are as well spread as all. When N < n: all points, then seeded repeats of them. When
        N == 0: zeros.

    Raises:
        CEIError: a point is not finite.
    """
    points = np.ascontiguousarray(points, dtype=np.float32)
    if not np.isfinite(points).all():
        raise CEIError("cannot thin a cloud with points that are not finite; crop it first.")
    if len(points) == 0:
        return np.zeros((n, points.shape[1]), dtype=np.float32)
    random = np.random.default_rng(seed)
    start, kept = int(random.integers(len(points))), min(n, len(points))
    axes = np.zeros((3, -(-len(points) // _BLOCK) * _BLOCK), dtype=np.float32)  # whole blocks
    axes[:, : len(points)] = points[:, :3].T
    spread = points[_farthest(axes[0], axes[1], axes[2], len(points), kept, start)]
    return np.concatenate([spread, spread[random.integers(kept, size=n - kept)]])


def share_sample(others: Array, robot: Array, share: float, n: int = 1024, seed: int = 0) -> Array:
    """Farthest points of two kinds, thinned apart, so that a large robot leaves points for small objects.

    Args:
        others: (N, 3 or 6) points that are no robot's, m.
        robot: (M, 3 or 6) points of the robot, m.
        share: of n that is the robot's at most, unless there are too few others to fill the rest.
        n: how many to keep.
        seed: see `farthest_point_sample`.

    Returns:
        (n, 3 or 6) float32, in turns by their shares: the first so many are as well spread, and shared alike, as all.
    """
    of_robot = min(max(round(share * n), n - len(others)), len(robot)) if len(others) else n
    parts = [(robot, of_robot), (others, n - of_robot)]
    turns = np.concatenate([(np.arange(count) + 0.5) / max(count, 1) for _, count in parts])
    both = np.concatenate([farthest_point_sample(points, count, seed) for points, count in parts])
    return both[np.argsort(turns, kind="stable")]


def first_of_voxels(points: Array, voxel_m: float) -> Array:
    """Indices (M,), rising, of the first point in each cell of a grid through the origin.

    Args:
        points: (N, 3) metres, finite, or (N, 6) with colours.
        voxel_m: edge of a cell, metres.
    """
    slots = np.full(1 << (2 * len(points)).bit_length(), -1)
    return np.flatnonzero(_is_first(np.floor(points[:, :3] / voxel_m).astype(np.int64), slots))


@njit(cache=True, nogil=True)
def _farthest(x, y, z, count, n, start):
    """(n,) indices, no two alike, each of the point farthest from those before it among the first `count`; the lowest where several are.

    Looks at all points n times, but eight to sixteen at a time, which beats trees (fpsample's) up to some 30,000 points.
    """
    gap = np.full(len(x), np.float32(np.inf))
    gap[count:] = -1  # never farthest, nor is what is chosen
    # Squares are not negative, so as integers their bits are in the same order; the largest of those vectorises, of floats it does not.
    blocks = gap.view(np.int32).reshape(-1, _BLOCK)
    chosen, point = np.empty(n, np.int64), start
    for k in range(n):
        chosen[k], gap[point] = point, -1
        px, py, pz = x[point], y[point], z[point]
        for i in range(len(x)):
            dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
            square = dx * dx + dy * dy + dz * dz
            last = gap[i]
            gap[i] = square if square < last else last
        largest, at = np.int32(-1), 0
        for block in range(len(blocks)):
            most = np.int32(-1)
            for i in range(_BLOCK):
                most = max(most, blocks[block, i])
            if most > largest:
                largest, at = most, block
        for i in range(_BLOCK):
            if blocks[at, i] == largest:
                point = at * _BLOCK + i
                break
    return chosen


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
