"""How the XHand takes hold in these demonstrations: a preshape and a closing synergy, in its own joints."""

from abc import ABC

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.expert import PadExpert
from cei_envs.experts.grip import Grip, grip_between_pads

_AWAY = {
    "right_hand_ring_joint1": 0.0,
    "right_hand_ring_joint2": 0.0,
    "right_hand_pinky_joint1": 0.0,
    "right_hand_pinky_joint2": 0.0,
}
OPENED = {
    "right_hand_thumb_bend_joint": 1.52,
    "right_hand_thumb_rota_joint1": 0.09,
    "right_hand_thumb_rota_joint2": 0.48,
    "right_hand_index_bend_joint": 0.0,
    "right_hand_index_joint1": 0.64,
    "right_hand_index_joint2": 0.66,
    "right_hand_mid_joint1": 0.73,
    "right_hand_mid_joint2": 0.45,
    **_AWAY,
}
"""100 mm between the thumb's pad and those of index and middle finger, rad."""

CLOSED = {
    "right_hand_thumb_bend_joint": 1.36,
    "right_hand_thumb_rota_joint1": 0.98,
    "right_hand_thumb_rota_joint2": -0.17,
    "right_hand_index_bend_joint": 0.0,
    "right_hand_index_joint1": 1.63,
    "right_hand_index_joint2": 0.0,
    "right_hand_mid_joint1": 1.635,
    "right_hand_mid_joint2": 0.0,
    **_AWAY,
}
"""Pads together, rad. On the straight way there the pads face each other, and what is between them stays where it is in the hand."""

_PADS_M = 0.010  # by so much the surfaces of pads that face each other are nearer than their middles
UP = np.array([0.0, 0.0, 1.0])
PALM = np.array([0.0, 0.0, 1.0])
"""Where the palm looks, in the grip."""
_FACING_ROOT = np.array([0.0, 0.92, -0.40])


class XHandExpert(PadExpert, ABC):
    """A script for the XHand: thumb against index and middle finger, the other two straight, out of the way."""

    def make_grip(self) -> Grip:
        return grip_between_pads(self.embodiment, self.width_m + _PADS_M, OPENED, CLOSED, _FACING_ROOT)

    def closed_to(self, room_m: float) -> float:
        """The share of the way to closed at which there is so much room between the pads' surfaces."""
        assert self.grip is not None
        return self.grip.share_of(room_m + _PADS_M)

    def sideways(self, heading_rad: float, down_rad: float) -> Rotation:
        """Orientation of the grip in the world: palm towards a heading and down by an angle, both as varied, the thumb on the right.

        It closes level, as what is upright would be turned otherwise.
        """
        heading, down = heading_rad + self.variation.yaw_rad, down_rad + self.variation.tilt_rad[0]
        ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
        return self.facing(np.cos(down) * ahead - np.sin(down) * UP, np.cross(UP, ahead))

    def over(self, closing_yaw_rad: float) -> Rotation:
        """Orientation of the grip in the world: palm down, closing towards a heading, which is away from the arm; leaning and turned as varied."""
        along = np.array([np.cos(closing_yaw_rad), np.sin(closing_yaw_rad), 0.0])
        varied = Rotation.from_euler("xyz", [*self.variation.tilt_rad, self.variation.yaw_rad])
        return varied * self.facing(-UP, along)
