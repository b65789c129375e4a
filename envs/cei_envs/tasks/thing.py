"""What there is to pick up: an object, how it lies, and where a person would take hold of it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.tasks.placed import Placed
from cei_gym.arrays import Array


@dataclass(frozen=True)
class Thing:
    """An object that can be picked up from a table.

    Attributes:
        placed: the object.
        height_m: of its origin above the table as it lies.
        width_m: across, where it is taken hold of.
        lying_rad: roll, pitch and yaw by which it lies, about the world's axes.
        grasp_m: from its origin to the middle of the grasp, along the world's axes as it lies.
        across_rad: heading, as it lies, along which a gripper closes.
    """

    placed: Placed
    height_m: float
    width_m: float
    lying_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    grasp_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    across_rad: float = np.pi / 2

    def at(self, x_m: float, y_m: float, yaw_rad: float, table_z_m: float) -> Array:
        """(7,) its state where it lies on a table, turned about the vertical."""
        turned = Rotation.from_euler("z", yaw_rad) * self._lying
        return np.array([x_m, y_m, table_z_m + self.height_m, *turned.as_quat(scalar_first=True)])

    def grasp_world(self, state: Array) -> tuple[Array, float]:
        """(3,) middle of a grasp, m, and the heading along which a gripper closes, rad, in a state (7,) as `at` gives it."""
        turned = Rotation.from_quat(state[3:7], scalar_first=True) * self._lying.inv()
        return state[:3] + turned.apply(self.grasp_m), float(turned.as_euler("ZYX")[0] + self.across_rad)

    @property
    def _lying(self) -> Rotation:
        return Rotation.from_euler("xyz", self.lying_rad)
