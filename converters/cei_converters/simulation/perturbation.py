"""Small ways in which a replay differs from what was recorded, as two days on a real table do: what holds by luck shows."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from cei_gym.arrays import Array
from cei_gym.augmentation import Offset, displacement, move_state
from cei_gym.demonstration import Demonstration

OBJECT_M, FRICTION, JOINT_RAD = 0.003, (0.8, 1.2), 0.002
"""How far objects are moved, by which factors friction is scaled, and the standard deviation of the arm's joints."""


@dataclass(frozen=True)
class Perturbation:
    """What is different.

    Attributes:
        offset: of all objects, as one.
        friction_scale: factor on all friction.
        joints_rad: (n_arm,) by which the arm's joints are off, as badly calibrated ones are, rad or m.
    """

    offset: Offset
    friction_scale: float
    joints_rad: Array

    @classmethod
    def draw(cls, episode: int, which: int, n_arm: int) -> Self:
        """The same for the same episode and number: objects are 3 mm away in some direction, friction is 0.8 to 1.2 times what it
        was, each of the arm's joints is off by some 2 mrad."""
        rng = np.random.default_rng([episode, which])
        heading = rng.uniform(-np.pi, np.pi)
        offset = Offset(OBJECT_M * np.cos(heading), OBJECT_M * np.sin(heading))
        return cls(offset, rng.uniform(*FRICTION), rng.normal(0.0, JOINT_RAD, n_arm))

    def start(self, state: Array, names: tuple[str, ...]) -> Array:
        """(k,) a state of objects, whose entries have these names, with objects moved.

        Raises:
            CEIError: no name is that of an object's place.
        """
        return move_state(state[None], names, displacement(self.offset, np.zeros(3)))[0]

    def moved(self, demonstration: Demonstration) -> Demonstration:
        """A demonstration by joints that are off."""
        off = np.zeros(demonstration.qpos.shape[1])
        off[: len(self.joints_rad)] = self.joints_rad
        return replace(demonstration, qpos=demonstration.qpos + off, action=demonstration.action + off)


def perturbations(demonstration: Demonstration, count: int, n_arm: int) -> list[Perturbation]:
    """The first so many perturbations of an episode."""
    return [Perturbation.draw(demonstration.index, which, n_arm) for which in range(count)]
