"""The hold that a twin is about: when the source carries something, and how its hand then moves, in the world."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from cei_gym.alignment.contact.correction import Holds
from cei_gym.alignment.grip import Grip
from cei_gym.arrays import Array

_CARRIED_M = 0.02
_LIES_M = 0.003  # what is carried by less still lies where it lay
_BESIDE_M, _FEW = 0.012, 5  # points so near the line between the contacts show what is between them
_PUSHED_M = 0.025  # at most, before fingers have closed
_PIXEL_M = 0.008  # how much of an edge a camera may miss


@dataclass(frozen=True)
class Hold:
    """The hold in which the source carries something farthest.

    Attributes:
        first, last: its frames, from the last at which what is held still lies, as fingers have closed by then.
        T_world_hand: (T, 4, 4) poses of the end-effector's root, of all frames.
        middle_world: (T, 3) between the contacts, m.
        contacts_world: (2, 3) where it takes hold, m.
        axis_world: (3,) unit, along which it closes then.
        carried_m: (T,) how far it carries; 0 outside.
    """

    first: int
    last: int
    T_world_hand: Array
    middle_world: Array
    contacts_world: Array
    axis_world: Array
    carried_m: Array

    @classmethod
    def of(cls, grip: Grip | None, dt_s: float, T_world_base: Array) -> Self | None:
        """That of a source's grip, which is in the frame of a base at a (4, 4) pose; None where nothing is carried by 2 cm."""
        holds = Holds.of(grip, dt_s)
        if grip is None or not len(holds):
            return None
        R, t = T_world_base[:3, :3], T_world_base[:3, 3]
        middle = grip.contacts.mean(axis=1) @ R.T + t
        best, far = None, _CARRIED_M
        for first, last in zip(holds.first.tolist(), holds.last.tolist(), strict=True):
            carried = np.zeros(len(middle))
            carried[first : last + 1] = np.linalg.norm(middle[first : last + 1] - middle[first], axis=1)
            if carried.max() > far:
                taken = first + int(np.argmax(np.append(carried[first : last + 1] > _LIES_M, True))) - 1
                best, far = (max(first, taken), last, carried), carried.max()
        if best is None:
            return None
        T = np.tile(np.eye(4), (len(middle), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = R @ grip.rotation, grip.position @ R.T + t
        first, last, carried = best
        return cls(first, last, T, middle, grip.contacts[first] @ R.T + t, R @ grip.axis[first], carried)

    def where_seen(self, points_world: Array) -> Self:
        """With its contacts where what is held lay before fingers pushed it, by (N, 3) points that were seen on it, and no farther apart than they
        show."""
        middle = self.contacts_world.mean(axis=0)
        offset = points_world - middle
        along = offset @ self.axis_world
        across = np.linalg.norm((offset - along[:, None] * self.axis_world)[:, :2], axis=1)
        beside = along[(across < _BESIDE_M) & (np.abs(along) < self.width_m / 2 + _PUSHED_M)]
        if len(beside) < _FEW:
            return self
        low, high = np.percentile(beside, [5, 95])
        half = min(self.width_m, float(high - low) + _PIXEL_M) / 2
        shift = float(low + high) / 2
        shift = 0.0 if abs(shift) < _PIXEL_M / 2 and half == self.width_m / 2 else shift
        sign = np.sign((self.contacts_world - middle) @ self.axis_world)
        moved = self.contacts_world - ((self.contacts_world - middle) @ self.axis_world)[:, None] * self.axis_world
        return replace(self, contacts_world=moved + (shift + sign * half)[:, None] * self.axis_world)

    @property
    def moved(self) -> Array:
        """(4, 4) how what is held moves with the hand, in the world, from the hold's begin to its end."""
        return self.T_world_hand[self.last] @ np.linalg.inv(self.T_world_hand[self.first])

    @property
    def width_m(self) -> float:
        """Of what is held, where it is held."""
        return float(np.abs(np.diff(self.contacts_world, axis=0)[0] @ self.axis_world))
