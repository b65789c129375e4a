"""An embodiment: arm x end-effector, compiled by MuJoCo, with its independent joints named and bounded."""

from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from cei_gym.embodiment.description import Description, load_description
from cei_gym.embodiment.resources import resolve
from cei_gym.embodiment.spec import ArmSpec, Coupling, EndEffectorSpec
from cei_gym.errors import CEIError, one_line, unknown

END_EFFECTOR_PREFIX = "ee/"
"""Keeps an end-effector's names apart from its arm's inside one model; public joint names do not carry it."""

CONTINUOUS_LIMIT_RAD = 2 * np.pi
"""Limit given to a hinge that declares none, so that every joint has a finite range."""

DEFAULT_MAX_VELOCITY_RAD_S = 3.14
"""Speed given to a hinge that declares none: half a turn a second, what small servos and the joints of light arms do."""

DEFAULT_MAX_VELOCITY_M_S = 0.5
"""Speed given to a slide that declares none: above the 0.42 m/s at which robosuite's Panda gripper snaps shut, so that
what a simulator recorded stays possible."""


@dataclass(frozen=True)
class Coupled:
    """Joint positions from independent joints, `q = A u + b`; each joint follows exactly one independent joint.

    Attributes:
        leader: (n,) index into u.
        scale, offset: (n,) so that `q = scale * u[leader] + offset`.
        independent: (m,) index into q of each independent joint (there, scale 1 and offset 0).
    """

    leader: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    independent: np.ndarray

    @cached_property
    def A(self) -> np.ndarray:
        """(n, m) coupling matrix."""
        matrix = np.zeros((len(self.leader), len(self.independent)))
        matrix[np.arange(len(self.leader)), self.leader] = self.scale
        return matrix

    def expand(self, u: np.ndarray) -> np.ndarray:
        """(..., m) independent joints to (..., n) joint positions."""
        return u[..., self.leader] * self.scale + self.offset

    def reduce(self, qpos: np.ndarray) -> np.ndarray:
        """(..., n) joint positions to (..., m) independent joints (followers are ignored)."""
        return qpos[..., self.independent]


@dataclass(frozen=True)
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
    """

    name: str
    arm: ArmSpec | None
    end_effector: EndEffectorSpec | None
    model: mujoco.MjModel
    joint_names: tuple[str, ...]
    joint_units: tuple[str, ...]
    n_arm: int
    lower: np.ndarray
    upper: np.ndarray
    max_velocity: np.ndarray
    coupled: Coupled
    home: np.ndarray
    closed: np.ndarray

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the model's bodies, in its order (0 is the base frame)."""
        return tuple(self.model.body(i).name for i in range(self.model.nbody))

    def body_id(self, name: str) -> int:
        """Index of a link; end-effector links may be named without their prefix."""
        names = self.body_names
        for candidate in (END_EFFECTOR_PREFIX + name, name):
            if candidate in names:
                return names.index(candidate)
        raise unknown(f"link of {self.name}", name, [_public(n) for n in names[1:]])

    @property
    def motors(self) -> tuple[tuple[int, float, float], ...]:
        """Of each motor that drives a joint, in the description's order: index into q, and the least and largest it can be told."""
        model = self.model
        on_joint = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
        ranges = model.actuator_ctrlrange[on_joint].tolist()
        return tuple((int(model.actuator_trnid[a, 0]), *told) for a, told in zip(on_joint, ranges, strict=True))

    @cached_property
    def independent_limits(self) -> tuple[np.ndarray, np.ndarray]:
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
    def independent_max_velocity(self) -> np.ndarray:
        """(m,) largest speeds of the independent joints, rad/s or m/s, such that followers too keep within theirs."""
        moves = self.coupled.scale != 0
        fastest = np.full(len(self.coupled.independent), np.inf)
        np.minimum.at(fastest, self.coupled.leader[moves], self.max_velocity[moves] / np.abs(self.coupled.scale[moves]))
        return fastest


def build_embodiment(
    arm: ArmSpec | None, end_effector: EndEffectorSpec | None, relative_to: Path = Path()
) -> Embodiment:
    """Compile an embodiment from its specifications.

    Args:
        arm, end_effector: at least one of them.
        relative_to: folder that relative description paths start from.

    Raises:
        CEIError: a description is missing or refused, or a specification names what the description lacks.
    """
    couplings: dict[str, Coupling] = {}
    max_velocity: dict[str, float] = {}
    if arm is not None:
        description = load_description(*resolve(arm.description, relative_to))
        spec = _subtree(arm, description)
        flange = spec.body(arm.mount_body)
        if flange is None:
            raise unknown(f"mount_body of {arm.name}", arm.mount_body, [b.name for b in spec.bodies])
        couplings |= description.couplings
        max_velocity |= description.max_velocity
        if arm.inertia_groups:
            spec.compiler.inertiagrouprange = arm.inertia_groups
    else:
        spec = mujoco.MjSpec()
        flange = spec.worldbody
    if end_effector is not None:
        description = load_description(*resolve(end_effector.description, relative_to))
        _attach(flange, end_effector, description)
        couplings |= {
            END_EFFECTOR_PREFIX + name: Coupling(END_EFFECTOR_PREFIX + c.joint, c.scale, c.offset, c.ignore_limits)
            for name, c in (description.couplings | end_effector.couplings).items()
        }
        max_velocity |= {END_EFFECTOR_PREFIX + name: speed for name, speed in description.max_velocity.items()}
    name = "-".join(part.name for part in (arm, end_effector) if part is not None)
    try:
        model = spec.compile()
    except ValueError as error:
        raise CEIError(f"{name}: MuJoCo cannot compile it: {one_line(error)}") from error
    return _from_model(name, arm, end_effector, model, couplings, max_velocity)


def _subtree(arm: ArmSpec, description: Description) -> mujoco.MjSpec:
    """The description, or the part of it that is the arm: of a humanoid, say."""
    spec = description.spec
    if arm.joints:
        names = [joint.name for joint in spec.joints]
        for joint in arm.joints:
            if joint not in names:
                raise unknown(f"joint in joints of {arm.name}", joint, names)
        held = {joint.name for joint in spec.joints} - set(arm.joints)
        for element in [*spec.actuators, *spec.equalities]:
            named = {element.target} if isinstance(element, mujoco.MjsActuator) else {element.name1, element.name2}
            if named & held:
                spec.delete(element)
        for joint in spec.joints:
            if joint.name in held:
                spec.delete(joint)
    if not arm.root_body:
        return spec
    root = spec.body(arm.root_body)
    if root is None:
        raise unknown(f"root_body of {arm.name}", arm.root_body, [b.name for b in spec.bodies])
    whole = mujoco.MjSpec()
    root.pos, root.quat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    whole.worldbody.add_frame().attach_body(root, "", "")
    return whole


def _attach(flange: mujoco.MjsBody, spec: EndEffectorSpec, description: Description) -> None:
    hand = description.spec
    if spec.angle:
        if spec.angle not in ("radian", "degree"):
            raise unknown(f"angle of {spec.name}", spec.angle, ["radian", "degree"])
        hand.compiler.degree = spec.angle == "degree"
    root = hand.body(spec.root_body) if spec.root_body else hand.worldbody.first_body()
    if root is None:
        raise unknown(f"root_body of {spec.name}", spec.root_body, [b.name for b in hand.bodies])
    disabled = {e.kind for e in spec.physics if not e.enabled}
    if spec.mount_pos_m and "mount" not in disabled:
        root.pos = spec.mount_pos_m
    if spec.mount_quat_wxyz and "mount" not in disabled:
        root.quat = spec.mount_quat_wxyz
    for exception in spec.physics:
        if exception.enabled and exception.kind == "geom_mass":
            geoms, mass_kg = (exception.parameters.get(name) for name in ("geoms", "mass_kg"))
            if not isinstance(geoms, str) or not isinstance(mass_kg, (int, float)) or mass_kg <= 0:
                raise CEIError(
                    f"geom_mass of {spec.name} needs `geoms` (a pattern) and `mass_kg` (above 0), not {exception.parameters}."
                )
            for geom in hand.geoms:
                if fnmatch(geom.name, geoms):
                    geom.mass = mass_kg
    if spec.inertia_groups:
        hand.compiler.inertiagrouprange = spec.inertia_groups
    flange.add_frame().attach_body(root, END_EFFECTOR_PREFIX, "")


def _public(name: str) -> str:
    return name.removeprefix(END_EFFECTOR_PREFIX)


def _from_model(
    name: str,
    arm: ArmSpec | None,
    end_effector: EndEffectorSpec | None,
    model: mujoco.MjModel,
    couplings: dict[str, Coupling],
    declared_max_velocity: dict[str, float],
) -> Embodiment:
    hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    names = [model.joint(i).name for i in range(model.njnt)]
    for joint, kind in zip(names, model.jnt_type, strict=True):
        if kind not in (hinge, slide):
            raise CEIError(f"{name}: joint {joint!r} is neither a hinge nor a slide.")
    public = [_public(n) for n in names]
    if len(set(public)) < len(public):
        raise CEIError(f"{name}: arm and end-effector share a joint name: {sorted(public)}.")
    is_hand = np.array([n.startswith(END_EFFECTOR_PREFIX) for n in names], bool)
    if np.any(np.diff(is_hand.astype(int)) < 0):
        raise CEIError(f"{name}: joints of arm and end-effector interleave; give the arm one chain to its mount_body.")
    limited = model.jnt_limited.astype(bool)
    for q in np.flatnonzero(~limited & (model.jnt_type == slide)):
        raise CEIError(f"{name}: joint {public[q]!r} slides without limits; its description should give it a range.")
    lower = np.where(limited, model.jnt_range[:, 0], -CONTINUOUS_LIMIT_RAD)
    upper = np.where(limited, model.jnt_range[:, 1], CONTINUOUS_LIMIT_RAD)
    on_joint = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    for a in np.flatnonzero(on_joint & (model.actuator_biasprm[:, 1] != 0) & model.actuator_ctrllimited):
        # A position servo cannot be told to go past its command range.
        q = model.actuator_trnid[a, 0]
        lower[q] = max(lower[q], model.actuator_ctrlrange[a, 0])
        upper[q] = min(upper[q], model.actuator_ctrlrange[a, 1])
    max_velocity = _max_velocity(names, model.jnt_type == hinge, arm, end_effector, declared_max_velocity)
    coupled = _couple(name, names, couplings)
    for q, joint in enumerate(names):
        if joint in couplings and couplings[joint].ignore_limits:
            leader = coupled.independent[coupled.leader[q]]
            ends = coupled.scale[q] * np.array([lower[leader], upper[leader]]) + coupled.offset[q]
            lower[q], upper[q] = ends.min(), ends.max()
            max_velocity[q] = abs(coupled.scale[q]) * max_velocity[leader]
    pose = {} if arm is None else dict(arm.home)
    pose |= {} if end_effector is None else end_effector.home
    home = _pose(name, public, coupled, pose)
    closed = _pose(name, public, coupled, pose | ({} if end_effector is None else end_effector.closed))
    units = tuple("rad" if kind == hinge else "m" for kind in model.jnt_type)
    embodiment = Embodiment(
        name,
        arm,
        end_effector,
        model,
        tuple(public),
        units,
        int(np.sum(~is_hand)),
        lower,
        upper,
        max_velocity,
        coupled,
        home,
        closed,
    )
    for label, values in (("home", home), ("closed", closed)):
        for q in np.flatnonzero((values < lower - 1e-6) | (values > upper + 1e-6)):
            raise CEIError(
                f"{name}: {label} puts {public[q]} at {values[q]:.4g}, outside [{lower[q]:.4g}, {upper[q]:.4g}] {units[q]}."
            )
    return embodiment


def _max_velocity(
    names: list[str],
    hinge: np.ndarray,
    arm: ArmSpec | None,
    end_effector: EndEffectorSpec | None,
    declared: dict[str, float],
) -> np.ndarray:
    speeds = dict(declared)
    for part, prefix in ((arm, ""), (end_effector, END_EFFECTOR_PREFIX)):
        if part is None:
            continue
        joints = [n for n in names if n.startswith(END_EFFECTOR_PREFIX) == bool(prefix)]
        for joint, speed in part.max_velocity.items():
            if prefix + joint not in joints:
                raise unknown(f"joint in max_velocity of {part.name}", joint, map(_public, joints))
            speeds[prefix + joint] = speed
    default = np.where(hinge, DEFAULT_MAX_VELOCITY_RAD_S, DEFAULT_MAX_VELOCITY_M_S)
    return np.array([speeds.get(n, d) for n, d in zip(names, default, strict=True)])


def _couple(name: str, names: list[str], couplings: dict[str, Coupling]) -> Coupled:
    for follower, c in couplings.items():
        for joint in (follower, c.joint):
            if joint not in names:
                raise unknown(f"joint in a coupling of {name}", _public(joint), [_public(n) for n in names])
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
                raise CEIError(f"{name}: couplings go round in a circle: {' -> '.join(map(_public, [*seen, joint]))}.")
            seen.append(joint)
        leader[q] = position[names.index(joint)]
    return Coupled(leader, scale, offset, np.array(independent, int))


def _pose(name: str, public: list[str], coupled: Coupled, values: dict[str, float]) -> np.ndarray:
    qpos = np.zeros(len(public))
    independent = [public[q] for q in coupled.independent]
    for joint, value in values.items():
        if joint not in independent:
            raise unknown(f"independent joint in a pose of {name}", joint, independent)
        qpos[public.index(joint)] = value
    return coupled.expand(coupled.reduce(qpos))
