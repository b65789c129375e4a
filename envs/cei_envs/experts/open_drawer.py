"""Scripted experts for OpenDrawer with a parallel gripper: one of robosuite's, or any by its pads."""

from collections.abc import Sequence
from typing import ClassVar

from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import GripperExpert, PadExpert, ReachesDown
from cei_envs.experts.plan import Waypoint
from cei_envs.tasks.cube import TABLE_Z_M
from cei_gym.arrays import Array

_HANDLE_CABINET_M = (-0.077, 0.0, 0.0725)
_ABOVE_M = 0.10
_PULL_M = 0.125


class _OpensDrawer(ReachesDown):
    """Reach over the handle, descend until the fingers straddle it, close, pull."""

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        x, y, yaw, opening = state
        cabinet = Rotation.from_euler("z", yaw)
        handle = cabinet.apply(_HANDLE_CABINET_M) + [x, y, TABLE_Z_M] - cabinet.apply([opening, 0, 0])
        # The offset along the bar is harmless, so people vary more there.
        along = self._amount * self._rng.uniform(-0.02, 0.02)
        grasp = handle + self.variation.offset_m + cabinet.apply([0, along, 0])
        rotation = self.reaching_down(yaw)
        pulled = grasp - cabinet.apply([_PULL_M, 0, 0])
        return [
            self.waypoint(grasp + [0, 0, _ABOVE_M], rotation, 0.0, 26),
            self.waypoint(grasp, rotation, 0.0, 14),
            self.waypoint(grasp, rotation, 1.0, 10),
            self.waypoint(pulled, rotation, 1.0, 30),
        ]


class OpenDrawerExpert(_OpensDrawer, GripperExpert):
    """With the grip site at the handle."""


class OpenDrawerPadExpert(_OpensDrawer, PadExpert):
    """With the handle between the pads."""

    width_m: ClassVar[float] = 0.016
