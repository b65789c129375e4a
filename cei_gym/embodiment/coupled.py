"""Joints that follow others: joint positions from independent joints."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.names import public_name
from cei_gym.embodiment.spec import Coupling
from cei_gym.errors import CEIError, unknown


@dataclass(frozen=True)
class Coupled:
    """Joint positions from independent joints, `q = A u + b`; each joint follows exactly one independent joint.

    Attributes:
        leader: (n,) index into u.
        scale, offset: (n,) so that `q = scale * u[leader] + offset`.
        independent: (m,) index into q of each independent joint (there, scale 1 and offset 0).
    """

    leader: Array
    scale: Array
    offset: Array
    independent: Array

    @cached_property
    def A(self) -> Array:
        """(n, m) coupling matrix."""
        matrix = np.zeros((len(self.leader), len(self.independent)))
        matrix[np.arange(len(self.leader)), self.leader] = self.scale
        return matrix

    def expand(self, u: Array) -> Array:
        """(..., m) independent joints to (..., n) joint positions."""
        return u[..., self.leader] * self.scale + self.offset

    def reduce(self, qpos: Array) -> Array:
        """(..., n) joint positions to (..., m) independent joints (followers are ignored)."""
        return qpos[..., self.independent]


def couple(name: str, names: list[str], couplings: dict[str, Coupling]) -> Coupled:
    """How the joints of an embodiment, by their names inside its model, follow each other.

    Raises:
        CEIError: a coupling names a joint that there is not, or couplings go round in a circle.
    """
    for follower, c in couplings.items():
        for joint in (follower, c.joint):
            if joint not in names:
                raise unknown(f"joint in a coupling of {name}", public_name(joint), [public_name(n) for n in names])
    independent = [q for q, joint in enumerate(names) if joint not in couplings]
    position = {q: u for u, q in enumerate(independent)}
    leader, scale, offset = np.zeros(len(names), int), np.ones(len(names)), np.zeros(len(names))
    for q, joint in enumerate(names):
        # Chains (a follows b follows c) are folded onto the independent joint at their end.
        seen = [joint]
        while joint in couplings:
            c = couplings[joint]
            scale[q], offset[q], joint = scale[q] * c.scale, offset[q] + scale[q] * c.offset, c.joint
            if joint in seen:
                raise CEIError(
                    f"{name}: couplings go round in a circle: {' -> '.join(map(public_name, [*seen, joint]))}."
                )
            seen.append(joint)
        leader[q] = position[names.index(joint)]
    return Coupled(leader, scale, offset, np.array(independent, int))
