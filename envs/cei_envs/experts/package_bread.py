"""A scripted expert for PackageBread with the XHand."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cei_envs.experts.plan import Waypoint
from cei_envs.experts.xhand import UP, XHandExpert
from cei_envs.tasks.cube import TABLE_Z_M
from cei_gym.arrays import Array

_HELD_M = 0.105  # above the slice's lower edge: fingertips reach 30 mm further down, to 10 mm above the toaster
_OPEN_M = 0.040
_RELEASED_M = 0.035
_ABOVE_M = 0.12
_INTO_M = 0.009  # the slice's lower edge above the table where it is let go: 6 mm above the bag's bottom
_PLACE_M = 0.005
_CARE = (0.3, 1.0, 0.3)  # in x and z, as the slot is narrow and the toaster near
_SQUEEZE_M = 0.008


class PackageBreadExpert(XHandExpert):
    """Reach over the toaster, descend around the slice, close across it, draw it out, carry it over the bag, lower, open, withdraw."""

    width_m: ClassVar[float] = 0.014

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        bread, toaster, bag = state[:7], state[7:10], state[10:]
        opened, released, held = (self.closed_to(x) for x in (_OPEN_M, _RELEASED_M, self.width_m - _SQUEEZE_M))
        taking, giving = self.over(toaster[2]), self.over(bag[2])
        taken = bread[:3] + _HELD_M * UP + np.multiply(self.variation.offset_m, _CARE)
        given = np.array([*bag[:2], TABLE_Z_M + _INTO_M + _HELD_M])
        given[:2] += self._amount * self._rng.uniform(-_PLACE_M, _PLACE_M, 2)
        up = _ABOVE_M * UP
        return [
            self.waypoint(taken + up / 2, taking, opened, 28),
            self.waypoint(taken, taking, opened, 14),
            self.waypoint(taken, taking, held, 12),
            self.waypoint(taken + up, taking, held, 22),
            self.waypoint(given + up, giving, held, 30),
            self.waypoint(given, giving, held, 22),
            self.waypoint(given, giving, released, 10),
            self.waypoint(given + up, giving, released, 18),
        ]
