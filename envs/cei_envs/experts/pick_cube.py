"""A scripted expert for PickCube with a parallel gripper."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import GripperExpert, upright
from cei_envs.experts.plan import Waypoint, grip_pose
from cei_gym.arrays import Array

_ABOVE_M = 0.10
_LIFT_M = 0.15


class PickCubeExpert(GripperExpert):
    """Reach over the cube, descend, close, lift."""

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        v = self.variation
        _, home = grip_pose(self.embodiment, self.embodiment.home)
        # A cube looks the same every quarter turn: take the one nearest to the hand's own heading.
        cube_yaw = Rotation.from_quat(state[3:7], scalar_first=True).as_euler("ZYX")[0]
        turn = (cube_yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4
        rotation = Rotation.from_euler("xyz", [*v.tilt_rad, turn + v.yaw_rad]) * upright(home)
        grasp = state[:3] + v.offset_m
        above, lift = grasp + [0, 0, _ABOVE_M], grasp + [0, 0, _LIFT_M]
        return [
            self.waypoint(above, rotation, 0.0, 26),
            self.waypoint(grasp, rotation, 0.0, 14),
            self.waypoint(grasp, rotation, 1.0, 10),
            self.waypoint(lift, rotation, 1.0, 20),
        ]
