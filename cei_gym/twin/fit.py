"""Primitives fitted to what is held: a ball rolls as a hull does not."""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.twin.complete import Completed
from cei_gym.twin.hold import Hold
from cei_gym.twin.seen import Seen
from cei_gym.twin.shape import Piece, Shape

_CONTACT_WEIGHT, _MIRRORED_WEIGHT = 3.0, 0.3
_EXPLAINED_M = 0.0025  # root mean square from the surface, outliers left out
_TRIMMED = 0.9
_CONTRADICTED = 0.1  # share of its surface, or of what is just below that, that is where nothing can be
_BELOW_M = 0.005  # as a pixel that sees past an edge is as wide
_LOSS_M = 0.003
_LEAST_M, _MOST_M = 0.004, 0.25


def fit_primitive(seen: Seen, completed: Completed, hold: Hold) -> Shape | None:
    """The sphere, cylinder or box that explains best what was seen; None where none does well enough."""
    known = np.concatenate([seen.points_world, completed.contacts_world])
    points = np.concatenate([known, completed.mirrored_world])
    weight = np.full(len(points), _MIRRORED_WEIGHT)
    weight[: len(seen.points_world)], weight[len(seen.points_world) : len(known)] = 1.0, _CONTACT_WEIGHT
    middle, best = hold.contacts_world.mean(axis=0), (_EXPLAINED_M, None)
    for first in _starts(points, middle, hold, seen.support_z_m):
        kind, start = first
        found = least_squares(
            lambda x, kind=kind: weight * _distance(_piece(kind, x, seen.support_z_m), points),
            start,
            loss="soft_l1",
            f_scale=_LOSS_M,
            max_nfev=40,
        )
        piece = _piece(kind, found.x, seen.support_z_m)
        if not all(_LEAST_M < size < _MOST_M for size in piece.size_m):
            continue
        away = np.sort(np.abs(_distance(piece, known)))[: int(_TRIMMED * len(known))]
        rms = float(np.sqrt(np.mean(away**2)))
        # a sphere has three figures, a box six, so that it fits by itself a little better
        rms *= {"sphere": 0.8, "cylinder": 0.9}.get(piece.kind, 1.0)
        if rms < best[0] and completed.impossible(_surface(piece)).mean() < _CONTRADICTED:
            best = (rms, piece)
    piece = best[1]
    return None if piece is None else Shape(piece.kind, (piece,))


def _starts(points: Array, middle: Array, hold: Hold, support: float) -> list[tuple[str, Array]]:
    """Kinds, and figures to begin with; all rest on the support."""
    top = float(np.percentile(points[:, 2], 98)) - support
    half = max(hold.width_m / 2, _LEAST_M)
    heading = float(np.arctan2(hold.axis_world[1], hold.axis_world[0]))
    along = np.array([-np.sin(heading), np.cos(heading)])
    reach = (points[:, :2] - middle[:2]) @ along
    length = max(float(np.ptp(np.percentile(reach, [3, 97]))) / 2, _LEAST_M)
    centre = middle[:2] + along * np.percentile(reach, [3, 97]).mean()
    return [
        ("sphere", np.array([*middle[:2], half])),
        ("standing", np.array([*middle[:2], half, top])),
        ("lying", np.array([*centre, heading + np.pi / 2, half, length])),
        ("lying", np.array([*centre, heading, length, half])),
        ("box", np.array([*centre, heading, half, length, top])),
    ]


def _piece(kind: str, x: Array, support: float) -> Piece:
    """A primitive of some figures."""
    if kind == "sphere":
        r = abs(x[2])
        return Piece("sphere", (r,), np.array([x[0], x[1], support + r]))
    if kind == "standing":
        r, h = abs(x[2]), abs(x[3]) / 2
        return Piece("cylinder", (r, h), np.array([x[0], x[1], support + h]))
    if kind == "lying":
        r, half = abs(x[3]), abs(x[4])
        R = Rotation.from_euler("z", x[2]).as_matrix() @ Rotation.from_euler("y", np.pi / 2).as_matrix()
        return Piece("cylinder", (r, half), np.array([x[0], x[1], support + r]), R)
    size = (abs(x[3]), abs(x[4]), abs(x[5]) / 2)
    R = Rotation.from_euler("z", x[2]).as_matrix()
    return Piece("box", size, np.array([x[0], x[1], support + size[2]]), R)


def _distance(piece: Piece, points: Array) -> Array:
    """(N,) signed distance of points from a primitive's surface, m."""
    p = (points - piece.centre_world) @ piece.rotation
    if piece.kind == "sphere":
        return np.linalg.norm(p, axis=1) - piece.size_m[0]
    if piece.kind == "cylinder":
        d = np.stack([np.hypot(p[:, 0], p[:, 1]) - piece.size_m[0], np.abs(p[:, 2]) - piece.size_m[1]], axis=1)
    else:
        d = np.abs(p) - piece.size_m
    return np.linalg.norm(np.maximum(d, 0), axis=1) + np.minimum(d.max(axis=1), 0)


def _surface(piece: Piece) -> Array:
    """(N, 3) points spread over a primitive, world."""
    size = np.maximum(np.array(piece.size_m) - _BELOW_M, 0.3 * np.array(piece.size_m))
    u = np.linspace(-1, 1, 9)
    grid = np.stack(np.meshgrid(u, u, u), axis=-1).reshape(-1, 3)
    grid = grid[np.abs(grid).max(axis=1) > 0.99]
    if piece.kind == "sphere":
        p = size[0] * grid / np.linalg.norm(grid, axis=1, keepdims=True)
    elif piece.kind == "cylinder":
        flat = (
            grid[:, :2]
            * (np.abs(grid[:, :2]).max(axis=1) / np.maximum(np.linalg.norm(grid[:, :2], axis=1), 1e-9))[:, None]
        )
        p = np.column_stack([size[0] * flat, size[1] * grid[:, 2]])
    else:
        p = grid * size
    return p @ piece.rotation.T + piece.centre_world
