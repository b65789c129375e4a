"""Building an embodiment: its descriptions joined, compiled, and their joints named and bounded."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.assets import MeshDiffersError
from cei_gym.embodiment.compiling import check_loops, compile_spec
from cei_gym.embodiment.coupled import Coupled, couple
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.joining import Joined, join
from cei_gym.embodiment.names import END_EFFECTOR_PREFIX, public_name
from cei_gym.embodiment.spec import ArmSpec, Coupling, EndEffectorSpec
from cei_gym.errors import CEIError, unknown

CONTINUOUS_LIMIT_RAD = 2 * np.pi
"""Limit given to a hinge that declares none, so that every joint has a finite range."""

DEFAULT_MAX_VELOCITY_RAD_S = 3.14
"""Speed given to a hinge that declares none: half a turn a second, what small servos and the joints of light arms do."""

DEFAULT_MAX_VELOCITY_M_S = 0.5
"""Speed given to a slide that declares none: above the 0.42 m/s at which robosuite's Panda gripper snaps shut, so that
what a simulator recorded stays possible."""


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
    name = "-".join(part.name for part in (arm, end_effector) if part is not None)
    joined, model, more = _compiled(name, arm, end_effector, relative_to)
    notes = [*joined.notes, *(f"{name}: {note}" for note in more)]
    embodiment = _from_model(name, arm, end_effector, model, joined.couplings, joined.max_velocity, notes)
    _built[:] = [(embodiment, joined.spec)]
    return embodiment


_built: list[tuple[Embodiment, mujoco.MjSpec]] = []
"""The last embodiment that was built, and what it was compiled from, until somebody takes that: to read it again takes half as long."""


def describe(embodiment: Embodiment) -> mujoco.MjSpec:
    """What an embodiment of the catalogue was compiled from, for who puts it among other things; it is the caller's.

    Names of the end-effector carry `END_EFFECTOR_PREFIX`; `assets` holds all files.

    Raises:
        CEIError: as for `build_embodiment`.
    """
    if _built and _built[0][0] is embodiment:
        return _built.pop()[1]
    joined, _, _ = _compiled(embodiment.name, embodiment.arm, embodiment.end_effector, Path())
    return joined.spec


def _compiled(
    name: str, arm: ArmSpec | None, end_effector: EndEffectorSpec | None, relative_to: Path
) -> tuple[Joined, mujoco.MjModel, list[str]]:
    """Descriptions joined, the model, and sentences about what was assumed."""
    for plain in (True, False):
        joined = join(arm, end_effector, relative_to, plain)
        assets = [description.assets for description in joined.descriptions]
        try:
            return joined, *compile_spec(name, joined.spec, assets, joined.held)
        except MeshDiffersError:
            if not plain:
                raise
    raise AssertionError


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
                f"{name}: joint {public_name(joint)!r} of link {public_name(model.body(body).name)!r} is neither a hinge nor a slide; a base stands still here, so take a free joint out of the"
                " description, or list an arm's own joints under `joints`."
            )
    public = [public_name(n) for n in names]
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
    servos = (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE) & (model.actuator_biasprm[:, 1] != 0)
    for a in np.flatnonzero(on_joint & servos & model.actuator_ctrllimited):
        # A position servo cannot be told to go past its command range.
        q = model.actuator_trnid[a, 0]
        to_joint = -model.actuator_gainprm[a, 0] / model.actuator_biasprm[a, 1] / model.actuator_gear[a, 0]
        ends = sorted(model.actuator_ctrlrange[a] * to_joint)
        lower[q], upper[q] = max(lower[q], ends[0]), min(upper[q], ends[1])
    max_velocity = _max_velocity(names, model.jnt_type == hinge, arm, end_effector, declared_max_velocity)
    coupled = couple(name, names, couplings)
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
    hinge: Array,
    arm: ArmSpec | None,
    end_effector: EndEffectorSpec | None,
    declared: dict[str, float],
) -> Array:
    speeds = dict(declared)
    for part, prefix in ((arm, ""), (end_effector, END_EFFECTOR_PREFIX)):
        if part is None:
            continue
        joints = [n for n in names if n.startswith(END_EFFECTOR_PREFIX) == bool(prefix)]
        for joint, speed in part.max_velocity.items():
            if prefix + joint not in joints:
                raise unknown(f"joint in max_velocity of {part.name}", joint, map(public_name, joints))
            speeds[prefix + joint] = speed
    default = np.where(hinge, DEFAULT_MAX_VELOCITY_RAD_S, DEFAULT_MAX_VELOCITY_M_S)
    return np.array([speeds.get(n, d) for n, d in zip(names, default, strict=True)])


def _pose(name: str, public: list[str], coupled: Coupled, values: dict[str, float]) -> Array:
    qpos = np.zeros(len(public))
    independent = [public[q] for q in coupled.independent]
    for joint, value in values.items():
        if joint not in independent:
            raise unknown(f"independent joint in a pose of {name}", joint, independent)
        qpos[public.index(joint)] = value
    return coupled.expand(coupled.reduce(qpos))
