"""The source's grip as its pads and the objects between them show it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import Delaunay, QhullError

from cei_gym.alignment.contact.pads import PadShapes, pad_shapes
from cei_gym.alignment.grip import Grip
from cei_gym.alignment.kernels.contact import SOFTNESS_M
from cei_gym.arrays import Array
from cei_gym.functional.representation import FunctionalRepresentation

_GRID_M = 0.002
_ALL = 0.9  # where this much of the pads may touch, they do: clouds have holes
_BETWEEN_POINTS_M = 0.005  # a surface goes on this far around a point seen on it


def source_grip(
    representation: FunctionalRepresentation,
    sides: Array,
    root: int,
    T_base_links: Array,
    held: Array,
    pads: PadShapes | None = None,
) -> Grip:
    """What a source does.

    Args:
        representation: its own.
        sides: (N,) of its pairs.
        root: link of its end-effector that carries all others.
        T_base_links: (T, L, 4, 4) its links, in the target's base frame.
        held: (T,) whether it holds something.
        pads: shapes of its pads, if they are at hand.
    """
    _, normals = representation.place(T_base_links)
    axis = normals[:, sides == 0].mean(axis=1) - normals[:, sides == 1].mean(axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    pads = pads or pad_shapes(representation, sides)
    contacts = np.zeros((len(axis), 2, 3))
    for side, points in zip(pads.side, pads.place(T_base_links), strict=True):
        pressing = axis if side == 0 else -axis
        depth = np.einsum("tvi,ti->tv", points, pressing)
        farthest = depth.max(axis=1, keepdims=True)
        weight = np.exp((depth - farthest) / SOFTNESS_M)
        touched = np.einsum("tv,tvi->ti", weight, points) / weight.sum(axis=1, keepdims=True)
        touched += (farthest - np.einsum("ti,ti->t", touched, pressing)[:, None]) * pressing
        contacts[:, side] += touched / (pads.side == side).sum()
    T_base_root = T_base_links[:, root]
    return Grip(axis, contacts, T_base_root[:, :3, 3], T_base_root[:, :3, :3], held)


def onto_objects(grip: Grip, pads: Array, objects: Sequence[Array], radius_m: float) -> Grip:
    """The grip with its contacts where objects are: a thin one may be held by the very edge of a pad.

    Where a hold begins, what is between the pads shows which part of them touches it; the contacts move, across the closing
    axis, to the middle of that part. They keep that place on the pads until the hold ends, and on the way to it.

    Args:
        grip: of the source.
        pads: (T, V, 3) vertices of its pads, same frame of reference, m.
        objects: for each frame (P, 3) points on objects, m.
        radius_m: what is farther from the line between the contacts is not held.
    """
    begins = np.flatnonzero(grip.held & ~np.append(False, grip.held[:-1]))
    if not len(begins):
        return grip
    places = np.array([_touched(grip.at(np.array([t])), pads[t], objects[t], radius_m) for t in begins])
    ends = np.flatnonzero(grip.held & ~np.append(grip.held[1:], False))
    hold = np.minimum(np.searchsorted(ends, np.arange(len(grip.held))), len(begins) - 1)
    shift = np.einsum("tij,tj->ti", grip.rotation, places[hold])
    return replace(grip, contacts=grip.contacts + shift[:, None])


def _touched(grip: Grip, pads: Array, points: Array, radius_m: float) -> Array:
    """(3,) from the contacts' middle to that of what the pads (V, 3) touch, in the end-effector's frame; 0 if nothing."""
    axis, middle = grip.axis[0], grip.contacts[0].mean(axis=0)
    across = np.linalg.svd(axis[None])[2][1:]
    outline, offset = (pads - middle) @ across.T, points - middle
    flat = offset @ across.T
    between = np.abs(offset @ axis) < 0.5 * np.linalg.norm(np.diff(grip.contacts[0], axis=0)) + SOFTNESS_M
    flat = flat[between & (np.linalg.norm(flat, axis=1) < radius_m)]
    # One camera sees little of what is below an edge; objects are taken to stand on something.
    flat = np.concatenate([flat, flat - radius_m * across[:, 2]])
    around = _BETWEEN_POINTS_M * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    steps = [np.arange(low, high, _GRID_M) for low, high in zip(outline.min(axis=0), outline.max(axis=0), strict=True)]
    grid = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    try:
        grid = grid[Delaunay(outline).find_simplex(grid) >= 0]
        may_touch = Delaunay((flat[:, None] + around).reshape(-1, 2)).find_simplex(grid) >= 0
        touched = grid[Delaunay(flat).find_simplex(grid) >= 0]
    except (QhullError, ValueError):  # nothing there
        return np.zeros(3)
    if may_touch.mean() > _ALL or not len(touched):
        return np.zeros(3)
    return grip.rotation[0].T @ ((touched.mean(axis=0) - grid.mean(axis=0)) @ across)
