"""A scripted expert for Door, with a parallel gripper."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import PadExpert
from cei_envs.experts.plan import Waypoint
from cei_envs.tasks.door import DOOR_Z_M
from cei_gym.arrays import Array

_FRAME_M = np.array([0.0, 0.22, 0.0])  # in the door's origin, as robosuite's description has it
_FRAME_YAW_RAD = -np.pi / 2
_DOOR_M, _HINGE_M = np.array([0.30, 0.0, 0.0]), np.array([0.255, 0.0, 0.0])
_LATCH_M = np.array([-0.175, 0.0, -0.025])
_HANDLE_M = np.array([0.115, -0.10, 0.0])  # where it is taken hold of, from the latch's axis
_ALONG_M = 0.015  # the offset along the handle is harmless, so people vary more there
_ABOVE_M = 0.12
_TURNED_RAD = (0.45, 0.90, 1.30)
_OPENED_RAD = (0.25, 0.52)  # further than it goes, as hands that follow fall short
_CARE = (0.5, 0.5, 0.7)
_LEAN_RAD = 0.75  # out from the door, into which the hand's back would bump
_UP = np.array([0.0, 0.0, 1.0])


class DoorExpert(PadExpert):
    """Reach over the handle, descend until the fingers straddle it, close, turn it down, pull the door open."""

    width_m: ClassVar[float] = 0.030

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        yaw = state[2]
        along = self._amount * self._rng.uniform(-_ALONG_M, _ALONG_M)
        offset = np.multiply(self.variation.offset_m, _CARE)
        out = Rotation.from_rotvec([0, 0, yaw]).apply([-1.0, 0.0, 0.0])
        taking = Rotation.from_rotvec(_LEAN_RAD * np.cross(_UP, out)) * self.reaching_down(yaw)

        def at(turned: float, opened: float, closed: float, frames: int) -> Waypoint:
            place = _on_handle(state, along, turned, opened) + Rotation.from_rotvec([0, 0, opened]).apply(offset)
            return self.waypoint(place, Rotation.from_rotvec([0, 0, opened]) * taking, closed, frames)

        above = _on_handle(state, along, 0.0, 0.0) + offset + [0, 0, _ABOVE_M]
        return [
            self.waypoint(above, taking, 0.0, 30),
            at(0.0, 0.0, 0.0, 16),
            at(0.0, 0.0, 1.0, 10),
            *(at(turned, 0.0, 1.0, 14) for turned in _TURNED_RAD),
            *(at(_TURNED_RAD[-1], opened, 1.0, 16) for opened in _OPENED_RAD),
        ]


def _on_handle(state: Array, along_m: float, turned_rad: float, opened_rad: float) -> Array:
    """(3,) place on the handle, world, m.

    Args:
        state: (5,) of the door.
        along_m: from where it is taken hold of, towards its end.
        turned_rad: of the handle, its end down.
        opened_rad: of the door.
    """
    on_latch = Rotation.from_rotvec([0, turned_rad, 0]).apply(_HANDLE_M + [along_m, 0, 0])
    on_door = _HINGE_M + Rotation.from_rotvec([0, 0, opened_rad]).apply(_LATCH_M + on_latch - _HINGE_M)
    on_frame = _FRAME_M + Rotation.from_rotvec([0, 0, _FRAME_YAW_RAD]).apply(_DOOR_M + on_door)
    return np.array([state[0], state[1], DOOR_Z_M]) + Rotation.from_rotvec([0, 0, state[2]]).apply(on_frame)
