"""An embodiment: arm x end-effector, compiled by MuJoCo, with its independent joints named and bounded."""

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.coupled import Coupled
from cei_gym.embodiment.names import END_EFFECTOR_PREFIX, public_name
from cei_gym.embodiment.spec import ArmSpec, EndEffectorSpec
from cei_gym.errors import unknown


@dataclass(frozen=True, eq=False)
class Embodiment:
    """An arm with an end-effector (either may be absent), at its base frame.

    Attributes:
        name: `<Arm>-<EndEffector>`.
        arm, end_effector: the specifications that it was built from.
        model: MuJoCo's compiled model; its world frame is the robot's base frame.
        joint_names: n names, arm then end-effector, as in the descriptions.
        joint_units: n units, "rad" or "m".
        n_arm: how many of the joints belong to the arm.
        lower, upper: (n,) joint limits, rad or m.
        max_velocity: (n,) largest speeds, rad/s or m/s: the YAML's, else the URDF's, else a default.
        coupled: how joints follow the independent ones.
        home, closed: (n,) rest pose, and the same with the end-effector closed.
        notes: sentences about what was assumed, and what of the descriptions is left out.
    """

    name: str
    arm: ArmSpec | None
    end_effector: EndEffectorSpec | None
    model: mujoco.MjModel
    joint_names: tuple[str, ...]
    joint_units: tuple[str, ...]
    n_arm: int
    lower: Array
    upper: Array
    max_velocity: Array
    coupled: Coupled
    home: Array
    closed: Array
    notes: tuple[str, ...] = ()

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the model's bodies, in its order (0 is the base frame)."""
        return tuple(self.model.body(i).name for i in range(self.model.nbody))

    @cached_property
    def of_end_effector(self) -> Array:
        """(B,) bool, which of the model's bodies are the end-effector's; the first of them carries the others."""
        return np.array([name.startswith(END_EFFECTOR_PREFIX) for name in self.body_names], bool)

    @property
    def end_effector_root(self) -> int:
        """Index of the end-effector's first link."""
        return int(np.argmax(self.of_end_effector))

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Names of the model's bodies as their descriptions have them, without the end-effector's prefix."""
        return tuple(public_name(name) for name in self.body_names)

    def body_id(self, name: str) -> int:
        """Index of a link; end-effector links may be named without their prefix."""
        names = self.body_names
        for candidate in (END_EFFECTOR_PREFIX + name, name):
            if candidate in names:
                return names.index(candidate)
        raise unknown(f"link of {self.name}", name, [public_name(n) for n in names[1:]])

    @property
    def motors(self) -> tuple[tuple[int, float, float], ...]:
        """Of each motor that drives a joint, in the description's order: index into q, and the least and largest it can be told."""
        model = self.model
        on_joint = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        ranges = model.actuator_ctrlrange[on_joint].tolist()
        return tuple((int(model.actuator_trnid[a, 0]), *told) for a, told in zip(on_joint, ranges, strict=True))

    @cached_property
    def independent_limits(self) -> tuple[Array, Array]:
        """(m,) bounds of the independent joints such that every joint, followers included, is within its limits."""
        lower = np.full(len(self.coupled.independent), -np.inf)
        upper = -lower
        for q, (u, scale, offset) in enumerate(
            zip(self.coupled.leader, self.coupled.scale, self.coupled.offset, strict=True)
        ):
            if scale == 0:
                continue
            a, b = sorted(((self.lower[q] - offset) / scale, (self.upper[q] - offset) / scale))
            lower[u], upper[u] = max(lower[u], a), min(upper[u], b)
        return lower, upper

    @cached_property
    def independent_max_velocity(self) -> Array:
        """(m,) largest speeds of the independent joints, rad/s or m/s, such that followers too keep within theirs."""
        moves = self.coupled.scale != 0
        fastest = np.full(len(self.coupled.independent), np.inf)
        np.minimum.at(fastest, self.coupled.leader[moves], self.max_velocity[moves] / np.abs(self.coupled.scale[moves]))
        return fastest
