"""The descriptions of an arm and an end-effector joined to one, with what they say of couplings and speeds."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import mujoco
import numpy as np

from cei_gym.embodiment.couplings import declared_couplings
from cei_gym.embodiment.description import Description, doubtful_units, load_description
from cei_gym.embodiment.names import END_EFFECTOR_PREFIX
from cei_gym.embodiment.resources import Place, locate, packages_beside
from cei_gym.embodiment.spec import ArmSpec, Coupling, EndEffectorSpec
from cei_gym.errors import CEIError, unknown

_BARE_KG, _BARE_KG_M2 = 1e-3, 1e-6


@dataclass(frozen=True)
class Joined:
    """One description of both.

    Attributes:
        spec: for MuJoCo to compile; names of the end-effector carry `END_EFFECTOR_PREFIX`.
        descriptions: what it was made of, the arm's first.
        couplings: by follower.
        max_velocity: of joints whose description gives a largest speed, rad/s or m/s.
        held: links whose joints were taken away.
        notes: sentences about what was assumed, and what is left out.
    """

    spec: mujoco.MjSpec
    descriptions: list[Description]
    couplings: dict[str, Coupling]
    max_velocity: dict[str, float]
    held: set[str]
    notes: list[str]


def join(arm: ArmSpec | None, end_effector: EndEffectorSpec | None, relative_to: Path, plain: bool = True) -> Joined:
    """Join what specifications name; either may be absent.

    Args:
        arm, end_effector, relative_to: as for `build_embodiment`.
        plain: as in `load_description`.

    Raises:
        CEIError: a description is missing or refused, or a specification names what the description lacks.
    """
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
            _leave_to_hand(arm, spec, description, end_effector, relative_to)
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
        _only(description.spec, end_effector, root.find_all("joint"))
        inside = {joint.name for joint in root.find_all("joint")}
        couplings |= {
            END_EFFECTOR_PREFIX + name: Coupling(END_EFFECTOR_PREFIX + c.joint, c.scale, c.offset, c.ignore_limits)
            for name, c in _couplings(end_effector, description, description.spec, inside, notes).items()
        }
        _attach(arm, flange, root, end_effector, description, notes)
        max_velocity |= {END_EFFECTOR_PREFIX + name: speed for name, speed in description.max_velocity.items()}
    return Joined(spec, descriptions, couplings, max_velocity, held, notes)


def _load(part: ArmSpec | EndEffectorSpec, relative_to: Path, plain: bool, notes: list[str]) -> Description:
    description = load_description(_place(part, relative_to), plain, part.xacro_args)
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
    spec = description.spec
    links = _only(spec, arm, spec.joints)
    if arm.until_body:
        _end_at(spec, arm)
    for link in arm.leave_out:
        _take_away(spec, _named(spec, link, f"link in leave_out of {arm.name}"))
    if not arm.root_body:
        return spec, links
    root = _named(spec, arm.root_body, f"root_body of {arm.name}")
    whole = mujoco.MjSpec()
    root.pos, root.quat = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    whole.worldbody.add_frame().attach_body(root, "", "")
    return whole, links


def _end_at(spec: mujoco.MjSpec, arm: ArmSpec) -> None:
    """Take away an arm's links from `until_body` on; of one that is the flange, its frame and its joint stay."""
    end = _named(spec, arm.until_body, f"until_body of {arm.name}")
    if arm.until_body != arm.mount_body:
        _take_away(spec, end)
        return
    for child in list(end.bodies):
        _take_away(spec, child)
    for geom in list(end.geoms):
        spec.delete(geom)
    # As much as a joint needs; what it carried is the end-effector's.
    end.fullinertia = np.full(6, np.nan)
    end.explicitinertial, end.mass, end.ipos, end.inertia = True, _BARE_KG, np.zeros(3), np.full(3, _BARE_KG_M2)


def _named(spec: mujoco.MjSpec, link: str, what: str) -> mujoco.MjsBody:
    found = spec.body(link)
    if found is None:
        raise unknown(what, link, [body.name for body in spec.bodies])
    return found


def _take_away(spec: mujoco.MjSpec, link: mujoco.MjsBody) -> None:
    """Take away a link and what hangs on it."""
    _hold(spec, {joint.name for joint in link.find_all("joint")})
    spec.delete(link)


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
    arm: ArmSpec, spec: mujoco.MjSpec, description: Description, end_effector: EndEffectorSpec, relative_to: Path
) -> None:
    """Where one file describes both, the links from the end-effector's root on are not the arm's, too."""
    root = spec.body(end_effector.root_body) if end_effector.root_body else None
    if root is None or root.name == arm.until_body == arm.mount_body:
        return
    if _place(end_effector, relative_to).path == description.assets.place.path:
        _take_away(spec, root)


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


def _only(spec: mujoco.MjSpec, part: ArmSpec | EndEffectorSpec, inside: Iterable[mujoco.MjsJoint]) -> set[str]:
    """Hold the joints of a part that its YAML does not list as its own; returns the links that they moved."""
    if not part.joints:
        return set()
    names = {joint.name for joint in inside}
    for joint in part.joints:
        if joint not in names:
            raise unknown(f"joint in joints of {part.name}", joint, names)
    return _hold(spec, names - set(part.joints))


def _attach(
    arm: ArmSpec | None,
    flange: mujoco.MjsBody,
    root: mujoco.MjsBody,
    spec: EndEffectorSpec,
    description: Description,
    notes: list[str],
) -> None:
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
    notes += [f"{spec.name}: {note}" for note in _touching(hand, spec)]
    frame = flange.add_frame()
    if arm is not None and arm.mount_pos_m:
        frame.pos = arm.mount_pos_m
    if arm is not None and arm.mount_quat_wxyz:
        frame.quat = arm.mount_quat_wxyz
    frame.attach_body(root, END_EFFECTOR_PREFIX, "")


def _touching(hand: mujoco.MjSpec, spec: EndEffectorSpec) -> Iterator[str]:
    """Have pads touch where a description has them for looks alone; sentences about those."""
    pads = {name for pad in spec.pads for name in pad.geoms}
    for geom in hand.geoms:
        if geom.name in pads and not (geom.contype or geom.conaffinity):
            geom.contype = geom.conaffinity = 1
            yield f"geom {geom.name!r} is only seen in its description; as a pad it touches, as its convex hull."
