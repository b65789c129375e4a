"""A scripted expert for InsertFlower with the XHand."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.plan import Waypoint
from cei_envs.experts.xhand import PALM, UP, XHandExpert
from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.insert_flower import RIM_M
from cei_gym.arrays import Array

_HEADING_RAD, _DOWN_RAD = np.radians(30), np.radians(8)  # of the approach: to the left of straight ahead, and down
_HELD_M = 0.105  # above the lower end of the stem
_BESIDE_M = 0.12
_OPEN_M = 0.050
_RELEASED_M = 0.060  # the blossoms follow the stem between the fingers
_OVER_M = 0.03  # the lower end of the stem above the rim
_LOW_M = 0.034  # the grip above the rim where it lets go
_OUT_M = 0.10  # along the stem, out of the hole: turned upright in it, it would turn between the fingers
_TIPS_M = 0.005  # further out than between the pads, where fingertips meet: from further in a stem slips to the palm
_SQUEEZE_M = 0.010  # so that both fingers press and the stem is square to them


class InsertFlowerExpert(XHandExpert):
    """Reach to the bouquet's side, move in, close across the stem, lift, carry it upright over the vase, lower, open, withdraw."""

    width_m: ClassVar[float] = 0.010

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        stem, vase = state[:7], state[10:]
        opened, released, held = (self.closed_to(x) for x in (_OPEN_M, _RELEASED_M, self.width_m - _SQUEEZE_M))
        lean = Rotation.from_quat(stem[3:], scalar_first=True)
        upright = self.sideways(_HEADING_RAD, _DOWN_RAD)
        taking = lean * upright
        height = _HELD_M + self.variation.offset_m[2]
        at = stem[:3] + lean.apply(height * UP) + np.multiply(self.variation.offset_m, [0.7, 0.7, 0])
        taken = at - _TIPS_M * taking.apply(PALM)
        rim = np.array([*vase[:2], TABLE_Z_M + RIM_M]) - _TIPS_M * upright.apply(PALM)
        over, into = rim + (_OVER_M + height) * UP, rim + _LOW_M * UP
        return [
            self.waypoint(taken - _BESIDE_M * taking.apply(PALM), taking, opened, 28),
            self.waypoint(taken, taking, opened, 16),
            self.waypoint(taken, taking, held, 12),
            self.waypoint(taken + lean.apply(_OUT_M * UP), taking, held, 16),
            self.waypoint(over, upright, held, 34),
            self.waypoint(into, upright, held, 20),
            self.waypoint(into, upright, released, 10),
            self.waypoint(into - _BESIDE_M * _level(upright.apply(PALM)), upright, released, 18),
        ]


def _level(direction: Array) -> Array:
    """(3,) its horizontal part, as a unit vector."""
    return direction * [1, 1, 0] / np.linalg.norm(direction[:2])
