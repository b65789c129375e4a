"""A scripted expert for PlaceBird with a parallel gripper."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import PadExpert
from cei_envs.experts.plan import Waypoint
from cei_gym.arrays import Array

_MIDDLE_M = (0.0, 0.0, 0.020)  # of the bird's body
_ABOVE_M = 0.14
_INTO_M = 0.055  # above the box's bottom
_PLACE_M = 0.01


class PlaceBirdExpert(PadExpert):
    """Reach over the bird, descend, close across its body, lift, carry over the box, lower, open, withdraw."""

    width_m: ClassVar[float] = 0.044

    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        bird, box = state[:7], state[7:]
        turned = Rotation.from_quat(bird[3:7], scalar_first=True)
        rotation = self.reaching_down(turned.as_euler("ZYX")[0] + np.pi / 2)
        grasp = bird[:3] + turned.apply(_MIDDLE_M) + np.array(self.variation.offset_m) * [0.7, 0.7, 0.5]
        place = np.array([*box[:2], bird[2] + _INTO_M])
        place[:2] += self._amount * self._rng.uniform(-_PLACE_M, _PLACE_M, 2)
        up = np.array([0, 0, _ABOVE_M])
        return [
            self.waypoint(grasp + up, rotation, 0.0, 26),
            self.waypoint(grasp, rotation, 0.0, 16),
            self.waypoint(grasp, rotation, 1.0, 10),
            self.waypoint(grasp + up, rotation, 1.0, 16),
            self.waypoint(place + up, rotation, 1.0, 22),
            self.waypoint(place, rotation, 1.0, 16),
            self.waypoint(place, rotation, 0.0, 10),
            self.waypoint(place + up, rotation, 0.0, 14),
        ]
