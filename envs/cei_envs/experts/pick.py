"""A scripted expert for things to pick up, with any hand whose first pad opposes its others."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cei_envs.experts.expert import PadExpert
from cei_envs.experts.grip import Grip, grip_between_pads
from cei_envs.experts.plan import Waypoint
from cei_envs.tasks.thing import Thing
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment

_ABOVE_M, _LIFT_M = 0.10, 0.12
_CARE = (0.7, 0.7, 0.3)  # of the grasp point's error along x, y and z: flat things lie low


class PickExpert(PadExpert):
    """Reach over the thing, descend, close across it, lift.

    Args:
        thing: what is picked up; the others as in `Expert`.
    """

    def __init__(
        self, embodiment: Embodiment, T_world_base: Array, seed: int, variation: float = 1.0, *, thing: Thing
    ) -> None:
        self._thing = thing
        super().__init__(embodiment, T_world_base, seed, variation)
        self._height_m = self._leaning_less()

    def _leaning_less(self) -> float:
        """Have the hand lean no more than lets both pads reach the thing while no fingertip touches the table; the least height of the grip above
        it, m."""
        assert self.grip is not None
        room = max(0.0, self._thing.height_m + self._thing.grasp_m[2] - (self.lowest_m - self.grip.reach_m))
        lean = float(np.linalg.norm(self.variation.tilt_rad))
        drop = np.sin(lean) * self.grip.widths_m[0] / 2
        share = min(1.0, room / drop) if drop else 1.0
        x, y = self.variation.tilt_rad
        self.variation = replace(self.variation, tilt_rad=(share * x, share * y))
        return self.lowest_m + share * drop

    def make_grip(self) -> Grip:
        """See `PadExpert.make_grip`."""
        return grip_between_pads(self.embodiment, self._thing.width_m)

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        grasp, across = self._thing.grasp_world(state)
        rotation = self.reaching_down(across)
        grasp = grasp + np.array(self.variation.offset_m) * _CARE
        grasp[2] = max(grasp[2], state[2] - self._thing.height_m + self._height_m)
        above, lift = grasp + [0, 0, _ABOVE_M], grasp + [0, 0, _LIFT_M]
        return [
            self.waypoint(above, rotation, 0.0, 26),
            self.waypoint(grasp, rotation, 0.0, 16),
            self.waypoint(grasp, rotation, 1.0, 10),
            self.waypoint(lift, rotation, 1.0, 20),
        ]
