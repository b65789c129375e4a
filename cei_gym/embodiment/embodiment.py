"""An embodiment: arm x end-effector, compiled by MuJoCo, with its independent joints named and bounded."""

from dataclasses import dataclass, replace
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from cei_gym.embodiment.assets import MeshDiffersError
from cei_gym.embodiment.compiling import check_loops, compile_spec
from cei_gym.embodiment.couplings import declared_couplings
from cei_gym.embodiment.description import Description, doubtful_units, load_description
from cei_gym.embodiment.resources import Place, locate, packages_beside
from cei_gym.embodiment.spec import ArmSpec, Coupling, EndEffectorSpec
from cei_gym.errors import CEIError, unknown

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
    lower: np.ndarray
    upper: np.ndarray
    max_velocity: np.ndarray
    coupled: Coupled
    home: np.ndarray
    closed: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the model's bodies, in its order (0 is the base frame)."""
        return tuple(self.model.body(i).name for i in range(self.model.nbody))

    @cached_property
    def of_end_effector(self) -> np.ndarray:
        """(B,) bool, which of the model's bodies are the end-effector's; the first of them carries the others."""
        return np.array([name.startswith(END_EFFECTOR_PREFIX) for name in self.body_names], bool)

    @property
    def end_effector_root(self) -> int:
        """Index of the end-effector's first link."""
        return int(np.argmax(self.of_end_effector))

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Names of the model's bodies as their descriptions have them, without the end-effector's prefix."""
        return tuple(_public(name) for name in self.body_names)

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
        relative_to: folder that relative description paths start from, if not the one that a specification was read from; what lies
            in it may be read.

    Raises:
        CEIError: a description is missing or refused, or a specification names what the description lacks.
    """
    try:
        return _build(arm, end_effector, relative_to)
    except MeshDiffersError:
        return _build(arm, end_effector, relative_to, plain=False)


def _build(
    arm: ArmSpec | None, end_effector: EndEffectorSpec | None, relative_to: Path, plain: bool = True
) -> Embodiment:
    couplings: dict[str, Coupling] = {}
    max_velocity: dict[str, float] = {}
    notes: list[str] = []
    descriptions: list[Description] = []
    held: set[str] = set()
    if arm is not None:
        description = _load(arm, relative_to, plain, notes)
        descriptions.append(description)
        spec, held = _subtree(arm, description)
        if end_effector is not None:
            _leave_to_hand(spec, description, end_effector, relative_to)
        flange = spec.body(arm.mount_body)
        if flange is None:
            raise unknown(f"mount_body of {arm.name}", arm.mount_body, [b.name for b in spec.bodies])
        couplings |= _couplings(arm, description, spec, {joint.name for joint in spec.joints}, notes)
        max_velocity |= description.max_velocity
        if arm.inertia_groups:
            spec.compiler.inertiagrouprange = arm.inertia_groups
    else:
        spec = mujoco.MjSpec()
        flange = spec.worldbody
    if end_effector is not None:
        description = _load(end_effector, relative_to, plain, notes)
        descriptions.append(description)
        root = _root(end_effector, description, notes)
        inside = {joint.name for joint in root.find_all("joint")}
        couplings |= {
            END_EFFECTOR_PREFIX + name: Coupling(END_EFFECTOR_PREFIX + c.joint, c.scale, c.offset, c.ignore_limits)
            for name, c in _couplings(end_effector, description, description.spec, inside, notes).items()
        }
        _attach(flange, root, end_effector, description)
        max_velocity |= {END_EFFECTOR_PREFIX + name: speed for name, speed in description.max_velocity.items()}
    name = "-".join(part.name for part in (arm, end_effector) if part is not None)
    model, more = compile_spec(name, spec, [description.assets for description in descriptions], held)
    notes += [f"{name}: {note}" for note in more]
    return _from_model(name, arm, end_effector, model, couplings, max_velocity, notes)


def _load(part: ArmSpec | EndEffectorSpec, relative_to: Path, plain: bool, notes: list[str]) -> Description:
    description = load_description(_place(part, relative_to), plain)
    if part.angle:
        description.spec.compiler.degree = part.angle == "degree"
    notes += [f"{part.name}: {note}" for note in (*description.notes, *doubtful_units(description.spec))]
    return description


def _place(part: ArmSpec | EndEffectorSpec, relative_to: Path) -> Place:
    trusted = [Path(part.folder)] if part.folder else []
    if relative_to != Path():
        trusted.append(relative_to)
    beside = packages_beside(Path(part.folder or relative_to), part.package_path)
    folder = relative_to if relative_to != Path() or not part.folder else Path(part.folder)
    return locate(part.description, folder, trusted, beside)


def _couplings(
    part: ArmSpec | EndEffectorSpec, description: Description, spec: mujoco.MjSpec, joints: set[str], notes: list[str]
) -> dict[str, Coupling]:
    """What the description, and over it the YAML, say of the joints of the part of it that is used."""
    try:
        declared, about = declared_couplings(spec, joints, part.couplings)
    except CEIError as error:
        raise CEIError(f"{description.assets.place.path.name}: {error}") from None
    notes += [f"{part.name}: {note}" for note in about]
    declared |= description.mimics
    return {follower: coupling for follower, coupling in declared.items() if follower in joints} | part.couplings


def _subtree(arm: ArmSpec, description: Description) -> tuple[mujoco.MjSpec, set[str]]:
    """The description, or the part of it that is the arm: of a humanoid, say; and the links whose joints are held."""
    spec, links = description.spec, set()
    if arm.joints:
        names = [joint.name for joint in spec.joints]
        for joint in arm.joints:
            if joint not in names:
                raise unknown(f"joint in joints of {arm.name}", joint, names)
        links = _hold(spec, {joint.name for joint in spec.joints} - set(arm.joints))
    if not arm.root_body:
        return spec, links
    root = spec.body(arm.root_body)
    if root is None:
        raise unknown(f"root_body of {arm.name}", arm.root_body, [b.name for b in spec.bodies])
    whole = mujoco.MjSpec()
    root.pos, root.quat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    whole.worldbody.add_frame().attach_body(root, "", "")
    return whole, links


def _hold(spec: mujoco.MjSpec, held: set[str]) -> set[str]:
    """Take joints away, with what refers to them; returns the links that they moved."""
    tendons = [t for t in spec.tendons if any(p.target is not None and p.target.name in held for p in t.path)]
    gone = {
        mujoco.mjtEq.mjEQ_JOINT: held,
        mujoco.mjtEq.mjEQ_TENDON: {tendon.name for tendon in tendons},
    }
    for equality in spec.equalities:
        if {equality.name1, equality.name2} & gone.get(equality.type, set()):
            spec.delete(equality)
    for actuator in spec.actuators:
        if actuator.target in held:
            spec.delete(actuator)
    for tendon in tendons:
        spec.delete(tendon)
    joints = [joint for joint in spec.joints if joint.name in held]
    links = {joint.parent.name for joint in joints}
    for joint in joints:
        spec.delete(joint)
    return links


def _leave_to_hand(
    spec: mujoco.MjSpec, description: Description, end_effector: EndEffectorSpec, relative_to: Path
) -> None:
    """Where one file describes both, the links from the end-effector's root on are not the arm's, too."""
    root = spec.body(end_effector.root_body) if end_effector.root_body else None
    if root is not None and _place(end_effector, relative_to).path == description.assets.place.path:
        _hold(spec, {joint.name for joint in root.find_all("joint")})
        spec.delete(root)


def _root(part: EndEffectorSpec, description: Description, notes: list[str]) -> mujoco.MjsBody:
    """The first link of an end-effector."""
    hand = description.spec
    if part.root_body:
        root = hand.body(part.root_body)
    else:
        root = hand.worldbody.first_body()
        left_out = [f"link {body.name!r}" for body in hand.worldbody.bodies[1:]]
        left_out += [f"geom {geom.name!r}" for geom in hand.worldbody.geoms]
        if root is not None and left_out:
            notes.append(
                f"{part.name}: {', '.join(left_out)} do not hang on {root.name!r}, the first link, and are left out."
            )
    if root is None:
        raise unknown(f"root_body of {part.name}", part.root_body, [b.name for b in hand.bodies])
    return root


def _attach(flange: mujoco.MjsBody, root: mujoco.MjsBody, spec: EndEffectorSpec, description: Description) -> None:
    hand = description.spec
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
    notes: list[str],
) -> Embodiment:
    hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    names = [model.joint(i).name for i in range(model.njnt)]
    for joint, kind, body in zip(names, model.jnt_type, model.jnt_bodyid, strict=True):
        if kind not in (hinge, slide):
            raise CEIError(
                f"{name}: joint {_public(joint)!r} of link {_public(model.body(body).name)!r} is neither a hinge nor a slide; a base stands still here, so take a free joint out of the"
                " description, or list an arm's own joints under `joints`."
            )
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
        to_joint = -model.actuator_gainprm[a, 0] / model.actuator_biasprm[a, 1] / model.actuator_gear[a, 0]
        ends = sorted(model.actuator_ctrlrange[a] * to_joint)
        lower[q], upper[q] = max(lower[q], ends[0]), min(upper[q], ends[1])
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
    given = [pose, pose | ({} if end_effector is None else end_effector.closed)]
    home, closed = (_pose(name, public, coupled, values) for values in given)
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
        tuple(notes),
    )
    embodiment = _with_poses_in_limits(embodiment, given)
    for label, values in (("home", embodiment.home), ("closed", embodiment.closed)):
        for q in np.flatnonzero((values < lower - 1e-6) | (values > upper + 1e-6)):
            raise CEIError(
                f"{name}: {label} puts {public[q]} at {values[q]:.4g}, outside [{lower[q]:.4g}, {upper[q]:.4g}] {units[q]}."
                f"{''.join(f' ({note})' for note in notes if 'degrees' in note)}"
            )
    half = (embodiment.home + embodiment.closed) / 2
    check_loops(name, model, {"home": embodiment.home, "half closed": half, "closed": embodiment.closed})
    return embodiment


def _with_poses_in_limits(embodiment: Embodiment, given: list[dict[str, float]]) -> Embodiment:
    """Joints that nobody gave a pose rest at 0, or at the end of their range that is nearest to it."""
    coupled = embodiment.coupled
    lower, upper = embodiment.independent_limits
    notes, poses = list(embodiment.notes), []
    for i in np.flatnonzero(~(lower < upper)):
        tied = [name for name, leader in zip(embodiment.joint_names, coupled.leader, strict=True) if leader == i]
        room = (
            f"the limits of {', '.join(tied)}, which follow each other" if len(tied) > 1 else f"the limits of {tied[0]}"
        )
        remedy = "say how they do under `couplings`, with `ignore_limits` for one whose limits do not bind"
        if lower[i] > upper[i] + 1e-9:
            raise CEIError(f"{embodiment.name}: {room}, leave no position for {tied[0]}; {remedy}.")
        notes.append(f"{embodiment.name}: {room}, leave {tied[0]} no room to move; {remedy}.")
    for values, qpos in zip(given, (embodiment.home, embodiment.closed), strict=True):
        u = coupled.reduce(qpos)
        for i, q in enumerate(coupled.independent):
            joint, inside = embodiment.joint_names[q], float(np.clip(u[i], lower[i], max(lower[i], upper[i])))
            if joint not in values and inside != u[i]:
                u[i] = inside
                note = (
                    f"{embodiment.name}: no `home` is given for {joint!r}, and 0 is outside its range of {lower[i]:.4g} to"
                    f" {upper[i]:.4g} {embodiment.joint_units[q]}; it rests at {inside:.4g}."
                )
                notes += [note] * (note not in notes)
        poses.append(coupled.expand(u))
    return replace(embodiment, home=poses[0], closed=poses[1], notes=tuple(notes))


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
