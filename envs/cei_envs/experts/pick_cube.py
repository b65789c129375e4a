"""Scripted experts for PickCube: with a parallel gripper, and with any hand whose first pad opposes its others."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import GripperExpert, upright
from cei_envs.experts.pick import PickExpert
from cei_envs.experts.plan import Waypoint, grip_pose
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.thing import Thing
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment

_ABOVE_M = 0.10
_LIFT_M = 0.15
_CUBE = Thing(Placed("cube"), height_m=0.02, width_m=0.042)


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


class PickCubePadExpert(PickExpert):
    """As other things are picked up, across those two sides for which it turns least."""

    def __init__(self, embodiment: Embodiment, T_world_base: Array, seed: int, variation: float = 1.0) -> None:
        super().__init__(embodiment, T_world_base, seed, variation, thing=_CUBE)

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        """See `PickExpert.waypoints`."""
        _, across = _CUBE.grasp_world(state)
        # Within what `reaching_down` leaves as it is.
        quarters = -np.floor((across - self.home_heading_rad + np.pi / 6) / (np.pi / 2))
        turned = Rotation.from_euler("z", quarters * np.pi / 2) * Rotation.from_quat(state[3:7], scalar_first=True)
        return super().waypoints(np.concatenate([state[:3], turned.as_quat(scalar_first=True)]))
