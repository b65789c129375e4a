"""A scripted expert for NutAssemblySquare, with a parallel gripper."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import PadExpert
from cei_envs.experts.plan import Waypoint
from cei_envs.tasks.nut_assembly_square import PEG_M, PEG_TOP_M
from cei_gym.arrays import Array

_HANDLE_M = 0.062  # from the middle of the hole: a large hand stays clear of the peg
_HALF_M = 0.010  # of its thickness
_ABOVE_M = 0.10
_OVER_M = 0.040  # the nut's middle above the top of the peg, where it is turned
_LET_GO_M = -0.035  # and where it is let go
_PLACE_ERROR_M = 0.002
_CARE = (0.7, 0.7, 0.2)  # of the grasp point's error along x, y and z: the nut lies low
_RELEASED_M = 0.055
_HEADING_RAD = np.pi  # of the handle on the peg: towards the robot, as the hand would be out of reach elsewhere
_UP = np.array([0.0, 0.0, 1.0])


class NutAssemblySquareExpert(PadExpert):
    """Reach over the handle, descend, close across it, lift, carry the nut over the peg while turning it, lower, open, withdraw."""

    width_m: ClassVar[float] = 0.032

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        nut = state[:3]
        yaw = Rotation.from_quat(state[3:7], scalar_first=True).as_euler("ZYX")[0]
        closing, turn = self._turns(yaw)
        taking = self._leaning(closing)
        giving = Rotation.from_rotvec(turn * _UP) * taking
        handle = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        across = np.array([-handle[1], handle[0], 0.0])
        offset = np.multiply(self.variation.offset_m, _CARE)
        grasp = nut + _HANDLE_M * handle + offset
        grasp[2] = max(grasp[2], nut[2] - _HALF_M + self.lowest_m)
        # Closing fingers centre the handle between them; what is left of the offset is carried along.
        held = grasp - nut - across * (across @ offset)
        peg = np.array([*PEG_M, PEG_TOP_M])
        peg[:2] += self._amount * self._rng.uniform(-_PLACE_ERROR_M, _PLACE_ERROR_M, 2)
        there = peg + Rotation.from_rotvec(turn * _UP).apply(held)
        over, given = there + _OVER_M * _UP, there + _LET_GO_M * _UP
        assert self.grip is not None
        released = self.grip.share_of(_RELEASED_M)
        lifted = np.array([*grasp[:2], over[2]])
        return [
            self.waypoint(grasp + _ABOVE_M * _UP, taking, 0.0, 30),
            self.waypoint(grasp, taking, 0.0, 16),
            self.waypoint(grasp, taking, 1.0, 10),
            self.waypoint(lifted, taking, 1.0, 20),
            self.waypoint(over, giving, 1.0, 36),
            self.waypoint(given, giving, 1.0, 20),
            self.waypoint(given, giving, released, 10),
            self.waypoint(over + _ABOVE_M * _UP, giving, released, 20),
        ]

    def _turns(self, yaw: float) -> tuple[float, float]:
        """The heading in which fingers close, as an angle from home's without a bound, and by how much the nut is then turned: the way on which the
        hand is turned least, at its worst."""
        at_home = self.home_heading_rad
        turn = (_HEADING_RAD - yaw + np.pi) % (2 * np.pi) - np.pi
        across = (yaw + np.pi - at_home) % np.pi - np.pi / 2  # half turns are alike, as fingers close from both sides
        start = min((across + half * np.pi for half in (-1, 0, 1)), key=lambda s: max(abs(s), abs(s + turn)))
        return at_home + start, turn

    def _leaning(self, closing_yaw_rad: float) -> Rotation:
        """As `reaching_down`, in just this heading."""
        v = self.variation
        along = np.array([np.cos(closing_yaw_rad), np.sin(closing_yaw_rad), 0.0])
        return Rotation.from_euler("xyz", [*v.tilt_rad, v.yaw_rad]) * self.facing(-_UP, along)
