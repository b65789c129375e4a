"""What an end-effector does to objects: the sides that close on each other, where they meet, when it holds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import Delaunay, QhullError

from cei_gym.compiled import njit
from cei_gym.embodiment.meshes import outermost
from cei_gym.functional.palmar import within_extent
from cei_gym.functional.representation import FunctionalRepresentation, pad_mesh
from cei_gym.kinematics.tree import KinematicTree

SOFTNESS_M = 1e-2  # how deep below the farthest a vertex still counts for where, across, a pad touches
_POSES = 11  # from open to closed, where opposition is looked for
_LEAST_OPPOSITION_RAD = 0.7  # between the mean normals of two sides that close on each other
_GRID_M = 0.002
_ALL = 0.9  # where this much of the pads may touch, they do: clouds have holes
_BETWEEN_POINTS_M = 0.005  # a surface goes on this far around a point seen on it


@dataclass(frozen=True)
class Grip:
    """An end-effector over T frames.

    Attributes:
        axis: (T, 3) unit direction in which side 0 presses; side 1 presses against it.
        contacts: (T, 2, 3) where each side meets what is between them, m.
        position, rotation: (T, 3), (T, 3, 3) of the end-effector's root: a held object moves with it.
        held: (T,) whether something is held.
    """

    axis: np.ndarray
    contacts: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    held: np.ndarray

    def at(self, frames: np.ndarray) -> "Grip":
        """The grip with its frames at these indices."""
        return Grip(*(value[frames] for value in vars(self).values()))

    @property
    def carried_m(self) -> np.ndarray:
        """(T,) how far the end-effector has moved since it took hold, m; 0 where it holds nothing."""
        carried, since = np.zeros(len(self.held)), None
        for t, held in enumerate(self.held):
            since = (t if since is None else since) if held else None
            if since is not None:
                carried[t] = np.linalg.norm(self.contacts[t].mean(axis=0) - self.contacts[since].mean(axis=0))
        return carried


def opposing_sides(representation: FunctionalRepresentation, tree: KinematicTree) -> np.ndarray | None:
    """(N,) side, 0 or 1, of each pair: pads whose normals face each other somewhere between open and closed.

    Returns:
        None where no two pads close on each other.
    """
    embodiment = representation.embodiment
    share = np.linspace(0, 1, _POSES)[:, None]
    qpos = np.repeat(embodiment.home[None], _POSES, axis=0)
    hand = slice(embodiment.n_arm, None)
    qpos[:, hand] += share * (embodiment.closed - embodiment.home)[hand]
    _, normals = representation.place(tree.forward(qpos))
    bodies, pad = np.unique(representation.body, return_inverse=True)
    mean = np.stack([normals[:, pad == i].mean(axis=1) for i in range(len(bodies))], axis=1)
    mean /= np.linalg.norm(mean, axis=2, keepdims=True)
    spread = mean - mean.mean(axis=1, keepdims=True)
    widest = np.square(spread).sum(axis=(1, 2)).argmax()
    mean, spread = mean[widest], spread[widest]
    along = spread @ np.linalg.svd(spread, full_matrices=False)[2][0]
    side = (along > 0) != (along[0] > 0)
    if not side.any():
        return None
    one, two = mean[~side].mean(axis=0), mean[side].mean(axis=0)
    cosine = one @ two / (np.linalg.norm(one) * np.linalg.norm(two))
    return side[pad].astype(np.int64) if cosine < np.cos(_LEAST_OPPOSITION_RAD) else None


@dataclass(frozen=True)
class PadShapes:
    """The pads of an end-effector as convex shapes: what of them can touch.

    Attributes:
        body: (P,) link of each pad.
        side: (P,) 0 or 1.
        vertices_link: for each, (V, 3) outermost vertices in the link's frame, m.
    """

    body: np.ndarray
    side: np.ndarray
    vertices_link: list[np.ndarray]

    def place(self, T_links: np.ndarray) -> list[np.ndarray]:
        """For each pad (T, V, 3) vertices, m, in the frame of the links' poses (T, L, 4, 4)."""
        return [
            np.einsum("tij,vj->tvi", T_links[:, body, :3, :3], vertices) + T_links[:, body, None, :3, 3]
            for body, vertices in zip(self.body, self.vertices_link, strict=True)
        ]


def pad_shapes(representation: FunctionalRepresentation, sides: np.ndarray) -> PadShapes:
    """The shapes of a representation's pads, with (N,) sides of its pairs: of each link only the part that is pad."""
    embodiment = representation.embodiment
    assert embodiment.end_effector is not None
    pads = embodiment.end_effector.pads
    body = np.array([embodiment.body_id(pad.body) for pad in pads])
    side = np.array([sides[representation.body == b][0] for b in body])
    surfaces = [within_extent(pad_mesh(embodiment, pad), pad.extent) for pad in pads]
    return PadShapes(body, side, [outermost(np.asarray(surface.vertices)) for surface in surfaces])


def source_grip(
    representation: FunctionalRepresentation,
    sides: np.ndarray,
    root: int,
    T_base_links: np.ndarray,
    held: np.ndarray,
) -> Grip:
    """What a source does.

    Args:
        representation: its own.
        sides: (N,) of its pairs.
        root: link of its end-effector that carries all others.
        T_base_links: (T, L, 4, 4) its links, in the target's base frame.
        held: (T,) whether it holds something.
    """
    _, normals = representation.place(T_base_links)
    axis = normals[:, sides == 0].mean(axis=1) - normals[:, sides == 1].mean(axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    pads = pad_shapes(representation, sides)
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


def onto_objects(grip: Grip, pads: np.ndarray, objects: Sequence[np.ndarray], radius_m: float) -> Grip:
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


def _touched(grip: Grip, pads: np.ndarray, points: np.ndarray, radius_m: float) -> np.ndarray:
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


@njit(cache=True, nogil=True)
def in_grip(points, contacts, radius_m):
    """(P,) which of the points (P, 3) lie between two contacts (2, 3), within a radius of the line through them."""
    line = contacts[1] - contacts[0]
    length = np.sqrt((line**2).sum())
    touching = length < 1e-6
    if not touching:
        line /= length
    inside = np.empty(len(points), dtype=np.bool_)
    for n in range(len(points)):
        offset = points[n] - contacts[0]
        along = 0.0 if touching else (offset * line).sum()
        across = np.sqrt(((offset - along * line) ** 2).sum())
        inside[n] = across < radius_m and (touching or -radius_m < along < length + radius_m)
    return inside
