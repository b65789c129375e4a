"""Hulls of what is held: one, or one for each slice across it, as a hammer's head is wider than its handle."""

from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from cei_gym.arrays import Array
from cei_gym.twin.complete import Completed
from cei_gym.twin.hold import Hold
from cei_gym.twin.shape import Piece, Shape

_SLICE_M = 0.018
_OVERLAP_M = 0.002
_NEAR_M = 0.02
_FLAT_M3 = 1e-9
_EMPTY = 1.3  # times the slices' volume


def one_hull(completed: Completed, hold: Hold, sliced: Shape | None) -> Shape | None:
    """The hull of all; None where there is none, of flat things, or where slices leave much of it empty."""
    piece = _hull(_as_wide(completed.points_world, hold))
    if piece is None or (sliced is not None and _volume(piece) > _EMPTY * sum(map(_volume, sliced.pieces))):
        return None
    return Shape("hull", (piece,))


def slices(completed: Completed, hold: Hold) -> Shape | None:
    """A hull of each slice along the horizontal that is square to the closing axis; None where there is none."""
    along = np.cross(hold.axis_world, [0, 0, 1])
    if np.linalg.norm(along) < 0.5:  # it closes from above
        along = np.array([1.0, 0.0, 0.0])
    along /= np.linalg.norm(along)
    points = _as_wide(completed.points_world, hold)
    at = points @ along
    count = max(1, round(float(np.ptp(at)) / _SLICE_M))
    edges = np.linspace(at.min(), at.max(), count + 1)
    pieces = []
    for low, high in pairwise(edges):
        inside = points[(at >= low - _OVERLAP_M) & (at <= high + _OVERLAP_M)]
        if (piece := _hull(inside)) is not None:
            pieces.append(piece)
    return Shape("slices", tuple(pieces)) if pieces else None


def _as_wide(points: Array, hold: Hold) -> Array:
    """Points no wider than what is held is where it is held: the contacts say so better than pixels."""
    middle = hold.contacts_world.mean(axis=0)
    offset = points - middle
    along = offset @ hold.axis_world
    across = np.linalg.norm(offset - along[:, None] * hold.axis_world, axis=1)
    half = hold.width_m / 2
    excess = np.where(across < _NEAR_M, along - np.clip(along, -half, half), 0.0)
    return points - excess[:, None] * hold.axis_world


def _volume(piece: Piece) -> float:
    return float(ConvexHull(piece.vertices_world).volume)


def _hull(points: Array) -> Piece | None:
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # too few, or flat
        return None
    return Piece("hull", vertices_world=points[hull.vertices]) if hull.volume > _FLAT_M3 else None
