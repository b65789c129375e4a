"""What tasks share whose objects are our own (`Placed`) on a table."""

from abc import ABC
from typing import Any, ClassVar

import numpy as np

from cei_envs.environment import CEIEnv
from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.placed import Placed
from cei_gym.arrays import Array


class ObjectsEnv(CEIEnv, ABC):
    """A table with objects; a task says which, where they start, and when it is done."""

    objects: ClassVar[tuple[Placed, ...]]
    """In the order in which the state has them."""

    table_width_m: ClassVar[float] = 0.8
    """Along y."""

    def make_robosuite(self, **robot_arguments: Any) -> Any:
        from cei_envs.tasks.tabletop import Tabletop

        return Tabletop(self.objects, self.table_width_m, **robot_arguments)

    def workspace_world(self) -> Array:
        half_m = self.table_width_m / 2
        return np.array([[-0.35, -half_m, TABLE_Z_M + 0.004], [0.35, half_m, TABLE_Z_M + 0.45]])

    def apply_state(self, state: Array) -> None:
        start = 0
        for each in self.objects:
            end = start + len(each.state_names)
            each.apply(self.simulation, state[start:end])
            start = end

    def read_state(self) -> Array:
        return np.concatenate([each.read(self.simulation) for each in self.objects])

    def is_free(self, thing: Placed) -> bool:
        """Whether nothing of the robot touches it."""
        return not self.simulation.touching(thing.geoms(self.simulation), self.simulation.robot_geoms)


def names_of(*objects: Placed) -> tuple[str, ...]:
    """Names with units of the state of some objects."""
    return tuple(name for each in objects for name in each.state_names)
