"""What tasks share in which one object is lifted: how far it is, and why it is not yet."""

from abc import ABC
from typing import ClassVar

from cei_envs.tasks.objects import ObjectsEnv
from cei_envs.tasks.placed import Placed

LIFTED_M, GRASPED_M = 0.05, 0.01


class LiftedEnv(ObjectsEnv, ABC):
    """A task that is done while its object is at least 5 cm above its start."""

    lifted: ClassVar[Placed]
    """The object."""

    def begin(self) -> None:
        self._start_z, self._highest = self._z_m, 0.0

    def is_done(self) -> bool:
        self._highest = max(self._highest, self._lifted_m)
        return self._lifted_m >= LIFTED_M

    def failure_reason(self) -> str:
        if self._highest < GRASPED_M:
            return "never grasped"
        return "slipped" if self._lifted_m < self._highest / 2 else "too low"

    @property
    def _z_m(self) -> float:
        return float(self.lifted.T_world(self.simulation)[2, 3])

    @property
    def _lifted_m(self) -> float:
        return self._z_m - self._start_z
