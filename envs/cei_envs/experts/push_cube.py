"""A scripted expert for PushCube with a parallel gripper."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import PadExpert
from cei_envs.experts.plan import Waypoint
from cei_envs.tasks.push_cube import HALF_M, PUSHED_M
from cei_gym.arrays import Array

_ABOVE_M = 0.10
_SQUEEZE_M = 0.008  # the cube is enclosed when fingers press by so much: with room around it, it turns and gets out
_FURTHER_M = 0.05


class PushCubeExpert(PadExpert):
    """Reach over the cube, descend around it, close until it is enclosed, push."""

    width_m: ClassVar[float] = 2 * HALF_M

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        assert self.grip is not None
        yaw = Rotation.from_quat(state[3:7], scalar_first=True).as_euler("ZYX")[0]
        rotation = self.reaching_down(yaw + np.pi / 2)
        around = state[:3] + np.multiply(self.variation.offset_m, [1, 0.3, 1])
        enclosed = self.grip.share_of(self.width_m - _SQUEEZE_M)
        pushed = around - [0, PUSHED_M + _FURTHER_M, 0]
        return [
            self.waypoint(around + [0, 0, _ABOVE_M], rotation, 0.0, 26),
            self.waypoint(around, rotation, 0.0, 14),
            self.waypoint(around, rotation, enclosed, 10),
            self.waypoint(pushed, rotation, enclosed, 36),
        ]
