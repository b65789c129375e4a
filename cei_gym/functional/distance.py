"""The Directional Chamfer Distance, equation (1) of the paper."""

from typing import Any

import numpy as np

DEFAULT_DIRECTION_WEIGHT_M = 0.05
"""Lambda in metres: what a cosine of 1 is worth in distance. The paper's 0.5 (points in metres) leaves a hand's pads about
twice as far off to turn its normals further: `benchmarks/direction_weight.py`."""


def directional_chamfer_distance(
    points: Any, normals: Any, points_other: Any, normals_other: Any, lambda_m: float
) -> Any:
    """DCD between two functional representations in one frame; lower is more similar.

    Each pair is matched to the one of the other set that minimises distance minus lambda times the normals' cosine:
    identical sets give -2 lambda, sets with opposite normals at the same points +2 lambda.

    Args:
        points, normals: (..., N, 3) m and unit.
        points_other, normals_other: (..., M, 3) m and unit.
        lambda_m: weight of direction, metres.

    Returns:
        (...) distance, metres. NumPy arrays in give NumPy out; torch tensors give a differentiable tensor.
    """
    cost = pair_cost(points, normals, points_other, normals_other, lambda_m)
    if isinstance(cost, np.ndarray):
        return cost.min(-1).mean(-1) + cost.min(-2).mean(-1)
    return cost.amin(-1).mean(-1) + cost.amin(-2).mean(-1)


def pair_cost(points: Any, normals: Any, points_other: Any, normals_other: Any, lambda_m: float) -> Any:
    """(..., N, M) cost of matching each pair of one set to each of the other, metres."""
    difference = points[..., :, None, :] - points_other[..., None, :, :]
    # torch's own norm has a zero (not infinite) gradient where two points coincide
    norm: Any = np.linalg.norm if isinstance(difference, np.ndarray) else _torch_norm
    return norm(difference, axis=-1) - lambda_m * normals @ normals_other.mT


def _torch_norm(x: Any, axis: int) -> Any:
    return x.norm(dim=axis)
