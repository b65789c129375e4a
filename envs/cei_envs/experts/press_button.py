"""A scripted expert for PressButton with a parallel gripper."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cei_envs.experts.expert import PadExpert
from cei_envs.experts.plan import Waypoint
from cei_envs.tasks.cube import TABLE_Z_M
from cei_gym.arrays import Array

_CAP_M = 0.0665  # top of the cap, above the table
_PRESS_M = 0.012  # further than its travel
_ABOVE_M = 0.09


class PressButtonExpert(PadExpert):
    """Close the fingers, reach over the button, press, hold, let go."""

    width_m: ClassVar[float] = 0.0

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        x, y, yaw, _ = state
        rotation = self.reaching_down(yaw + np.pi / 2)
        assert self.grip is not None
        top = np.array([x, y, TABLE_Z_M + _CAP_M + self.grip.reach_m]) + np.multiply(self.variation.offset_m, [1, 1, 0])
        up, pressed = np.array([0, 0, _ABOVE_M]), np.array([0, 0, -_PRESS_M])
        return [
            self.waypoint(top + up, rotation, 1.0, 26),
            self.waypoint(top + pressed, rotation, 1.0, 22),
            self.waypoint(top + pressed, rotation, 1.0, 24),
            self.waypoint(top + up, rotation, 1.0, 14),
        ]
