"""Fewer triangles from a mesh whose detail is finer than a camera sees."""

import numpy as np

from cei_gym.arrays import Array


def cluster_vertices(vertices: Array, faces: Array, cell_m: float) -> tuple[Array, Array]:
    """Merges the vertices that share a cubic cell, and drops the triangles that collapse.

    Every vertex moves less than `sqrt(3) * cell_m`. Unlike quadric edge collapse this cannot tear a mesh
    whose seams are not welded (robots' seldom are): equal vertices share a cell.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) integers.
        cell_m: edge of a cell, metres.

    Returns:
        vertices (V', 3) float64 and faces (F', 3) int32.
    """
    cell = np.floor((vertices - vertices.min(axis=0)) / cell_m).astype(np.int64)
    _, x_count, y_count = 1 + cell.max(axis=0)[::-1]
    key = (cell[:, 2] * y_count + cell[:, 1]) * x_count + cell[:, 0]
    _, cluster, count = np.unique(key, return_inverse=True, return_counts=True)
    centres = np.stack([np.bincount(cluster, axis) / count for axis in vertices.T], axis=1)
    merged = cluster.astype(np.int32)[faces]
    a, b, c = merged.T
    return np.ascontiguousarray(centres), merged[(a != b) & (b != c) & (c != a)]


def is_closed(faces: Array) -> bool:
    """Whether every directed edge has its opposite, so that no back of a triangle is seen from outside."""
    start = faces.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    count = start.max(initial=0) + 1
    return np.array_equal(np.sort((start * count + end).ravel()), np.sort((end * count + start).ravel()))
