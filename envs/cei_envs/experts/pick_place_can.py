"""A scripted expert for PickPlaceCan, with a parallel gripper."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import PadExpert
from cei_envs.experts.plan import Waypoint
from cei_envs.tasks.pick_place_can import BIN_2_M, CAN_Z_M
from cei_gym.arrays import Array

_ABOVE_M = 0.12
_CARRY_Z_M = 1.02  # of the grip: the can passes over walls that end at 0.90
_HELD_M = 0.010  # the grip above the can's middle
_PLACE_M = (0.050, 0.070)  # from the compartment's near corner: its far half is out of a Panda's reach
_PLACE_ERROR_M = 0.010
_LET_GO_M = 0.015  # the can above the floor
_RELEASED_M = 0.070  # between the pads: wide open, a finger would push against the wall
_LEAN_RAD = 0.3  # away from the robot, as that reaches further
_HEADING_RAD = 0.5  # people take hold of a round can from where they like
_UP = np.array([0.0, 0.0, 1.0])


class PickPlaceCanExpert(PadExpert):
    """Reach over the can, descend, close, lift, carry it over its compartment, lower, open, withdraw."""

    width_m: ClassVar[float] = 0.050

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        heading = np.pi / 2 + self._amount * self._rng.uniform(-_HEADING_RAD, _HEADING_RAD)
        taking = self.reaching_down(heading)
        offset = np.array(self.variation.offset_m)
        grasp = state[:3] + _HELD_M * _UP + offset
        given = np.array([*(BIN_2_M[:2] + _PLACE_M), CAN_Z_M + _HELD_M + offset[2] + _LET_GO_M])
        given[:2] += self._amount * self._rng.uniform(-_PLACE_ERROR_M, _PLACE_ERROR_M, 2)
        away = given - np.linalg.inv(self._T_base_world)[:3, 3]
        giving = Rotation.from_rotvec(_LEAN_RAD * np.cross(away, _UP) / np.linalg.norm(away[:2])) * taking
        assert self.grip is not None
        released = self.grip.share_of(_RELEASED_M)
        lifted, over = (np.array([*at[:2], _CARRY_Z_M]) for at in (grasp, given))
        return [
            self.waypoint(grasp + _ABOVE_M * _UP, taking, 0.0, 26),
            self.waypoint(grasp, taking, 0.0, 16),
            self.waypoint(grasp, taking, 1.0, 10),
            self.waypoint(lifted, taking, 1.0, 18),
            self.waypoint(over, giving, 1.0, 34),
            self.waypoint(given, giving, 1.0, 20),
            self.waypoint(given, giving, released, 10),
            self.waypoint(over, giving, released, 18),
        ]
