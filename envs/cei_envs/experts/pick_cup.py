"""A scripted expert for PickCup with the XHand."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cei_envs.experts.plan import Waypoint
from cei_envs.experts.xhand import PALM, UP, XHandExpert
from cei_gym.arrays import Array

_HEADING_RAD, _DOWN_RAD = np.radians(30), np.radians(30)  # of the approach: to the left of straight ahead, and down
_HEIGHT_M = 0.060  # of the grasp
_BESIDE_M = 0.10
_LIFT_M = 0.085
_SQUEEZE_M = 0.015


class PickCupExpert(XHandExpert):
    """Reach to the cup's side, move in, close across it, lift."""

    width_m: ClassVar[float] = 0.064

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        rotation = self.sideways(_HEADING_RAD, _DOWN_RAD)
        grasp = state[:3] + _HEIGHT_M * UP + np.array(self.variation.offset_m)
        beside = grasp - _BESIDE_M * rotation.apply(PALM)
        held = self.closed_to(self.width_m - _SQUEEZE_M)
        return [
            self.waypoint(beside, rotation, 0.0, 26),
            self.waypoint(grasp, rotation, 0.0, 18),
            self.waypoint(grasp, rotation, held, 12),
            self.waypoint(grasp + _LIFT_M * UP, rotation, held, 20),
        ]
