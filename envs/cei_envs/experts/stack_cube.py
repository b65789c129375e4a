"""A scripted expert for StackCube with a parallel gripper."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import GripperExpert
from cei_envs.experts.plan import Waypoint
from cei_envs.tasks.cube import STATE_SIZE
from cei_gym.arrays import Array

_ABOVE_M = 0.10
_LET_GO_M = 0.002  # above the green cube
_PLACE_M = 0.003  # error of the place, each way


class StackCubeExpert(GripperExpert):
    """Reach over the red cube, descend, close, lift, carry over the green cube, lower, open, withdraw."""

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        red, green = state[:STATE_SIZE], state[STATE_SIZE:]
        red_yaw = Rotation.from_quat(red[3:7], scalar_first=True).as_euler("ZYX")[0]
        # Of the two ways to grasp the red cube, the one whose fingers stay away from the green one.
        to_green = np.arctan2(green[1] - red[1], green[0] - red[0])
        closing_yaw = max(red_yaw, red_yaw + np.pi / 2, key=lambda yaw: abs(np.sin(yaw - to_green)))
        rotation = self.reaching_down(closing_yaw)
        offset = np.array(self.variation.offset_m)
        grasp = red[:3] + offset
        # Closing fingers centre the cube between them; what is left of the offset is carried along.
        closing = np.array([np.cos(closing_yaw), np.sin(closing_yaw), 0.0])
        carried = offset - closing * (closing @ offset)
        place = green[:3] + [0, 0, green[9] + red[9] + _LET_GO_M] + carried
        place[:2] += self._amount * self._rng.uniform(-_PLACE_M, _PLACE_M, 2)
        up = np.array([0, 0, _ABOVE_M])
        return [
            self.waypoint(grasp + up, rotation, 0.0, 26),
            self.waypoint(grasp, rotation, 0.0, 14),
            self.waypoint(grasp, rotation, 1.0, 10),
            self.waypoint(grasp + up, rotation, 1.0, 16),
            self.waypoint(place + up, rotation, 1.0, 16),
            self.waypoint(place, rotation, 1.0, 20),
            self.waypoint(place, rotation, 0.0, 10),
            self.waypoint(place + up, rotation, 0.0, 16),
        ]
