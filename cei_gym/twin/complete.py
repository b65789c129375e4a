"""What cameras did not see of what is held, from what they saw, from where it was taken hold of, and from where nothing can be."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cei_gym.arrays import Array
from cei_gym.twin.hold import Hold
from cei_gym.twin.seen import FreeSpace, Seen

_CONTRADICTED = 0.15  # share of mirrored points where nothing can be, above which a thing is not so symmetric
_PATCH_M = 0.004
_STEP_M = 0.006
_BESIDE_M, _FEW, _TOP = 0.02, 5, 90  # where the top of what is held is looked for; percent


@dataclass(frozen=True)
class Completed:
    """What is held.

    Attributes:
        points_world: (N, 3) on it and in it, where it lay, m.
        contacts_world: (C, 3) of them where the source touched it.
        mirrored_world: (M, 3) of them that only symmetry says are on its surface.
        impossible: whether (N, 3) points are where nothing can be, by what was seen and what is symmetric.
    """

    points_world: Array
    contacts_world: Array
    mirrored_world: Array
    impossible: Callable[[Array], Array]


def complete(seen: Seen, hold: Hold, fingers: Callable[[Array], Array]) -> Completed:
    """Complete what was seen: contacts are on it; it is as symmetric about the grip as what was seen does not contradict; and it goes down to
    the support, unless that was seen to be free, or fingers went there.

    Args:
        seen: of what is held.
        hold: of the source.
        fingers: whether (N, 3) points, world, are where the source's fingers were.
    """
    contacts = _patches(hold, seen)
    points = np.concatenate([seen.points_world, contacts])
    symmetries = [each for each in _symmetries(hold) if _holds(each, seen.points_world, seen.free)]

    def impossible(p: Array) -> Array:
        free = seen.free.contains(p) | fingers(p)
        for symmetry in symmetries:
            free |= seen.free.contains(symmetry(p))
        return free

    mirrored = np.concatenate([np.zeros((0, 3)), *[symmetry(points) for symmetry in symmetries]])
    mirrored = mirrored[~impossible(mirrored)]
    below = _below(np.concatenate([points, mirrored]), seen.support_z_m)
    whole = np.concatenate([points, mirrored, below[~impossible(below)]])
    return Completed(whole, contacts, mirrored, impossible)


def _patches(hold: Hold, seen: Seen) -> Array:
    """(10, 3) the contacts, and what is around them across the closing axis; no higher than what was seen there, as pads reach past flat things."""
    across = np.linalg.svd(hold.axis_world[None])[2][1:]
    around = np.concatenate([np.zeros((1, 3)), _PATCH_M * across, -_PATCH_M * across])
    near = np.linalg.norm((seen.points_world - hold.contacts_world.mean(axis=0))[:, :2], axis=1)
    beside = seen.points_world[near < max(_BESIDE_M, float(np.sort(near)[:_FEW][-1])), 2]
    top = max(float(np.percentile(beside, _TOP)), seen.support_z_m + _PATCH_M)
    middle = hold.contacts_world.copy()
    middle[:, 2] = np.minimum(middle[:, 2], np.maximum(top - _PATCH_M, seen.support_z_m))
    patches = (middle[:, None] + around).reshape(-1, 3)
    patches[:, 2] = np.clip(patches[:, 2], seen.support_z_m, top)
    return patches


def _symmetries(hold: Hold) -> list[Callable[[Array], Array]]:
    """Mirrored along the closing axis, turned about the vertical by half, both, about the middle of the contacts."""
    middle = hold.contacts_world.mean(axis=0)
    axis = hold.axis_world * [1, 1, 0] if abs(hold.axis_world[2]) < 0.5 else hold.axis_world
    axis = axis / np.linalg.norm(axis)
    mirror, turn = np.eye(3) - 2 * np.outer(axis, axis), np.diag([-1.0, -1.0, 1.0])
    return [lambda p, S=S: (p - middle) @ S.T + middle for S in (mirror, turn, mirror @ turn)]


def _holds(symmetry: Callable[[Array], Array], points: Array, free: FreeSpace) -> bool:
    return bool(free.views) and float(free.contains(symmetry(points)).mean()) < _CONTRADICTED


def _below(points: Array, support_z_m: float) -> Array:
    """What is under points, down to the support."""
    _, cells = np.unique(np.floor(points[:, :2] / _STEP_M).astype(int), axis=0, return_index=True)
    columns = [
        np.column_stack([np.tile(p[:2], (k, 1)), np.linspace(support_z_m, p[2], k, endpoint=False)])
        for p in points[cells]
        if (k := int((p[2] - support_z_m) / _STEP_M) + 1) > 0
    ]
    return np.concatenate([np.zeros((0, 3)), *columns])
