"""What tasks share that are done when one object is in another and let go."""

from abc import ABC, abstractmethod

from cei_envs.tasks.objects import ObjectsEnv

LIFTED_M = 0.02


class PutIntoEnv(ObjectsEnv, ABC):
    """Its first object is free, and goes into another."""

    @property
    @abstractmethod
    def is_inside(self) -> bool:
        """Whether it is there."""

    def begin(self) -> None:
        self._start_z_m, self._highest_m = self._height_m, 0.0

    def is_done(self) -> bool:
        self._highest_m = max(self._highest_m, self._height_m - self._start_z_m)
        return self.is_inside and self.is_free(self.objects[0])

    def failure_reason(self) -> str:
        if self._highest_m < LIFTED_M:
            return "never grasped"
        return "dropped" if self.is_free(self.objects[0]) else "not released"

    @property
    def _height_m(self) -> float:
        return float(self.objects[0].T_world(self.simulation)[2, 3])
