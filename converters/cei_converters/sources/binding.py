"""A joint map tied to one embodiment and the columns of one dataset: `u = scale * column + offset`."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cei_converters.sources.joint_map import SI, JointGroup, JointMap
from cei_converters.sources.pose import PoseMap, Span
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError, unknown

ARM, END_EFFECTOR = "arm", "end_effector"
REST = "rest"
_PER_SI = {SI: 1.0, "rad": 1.0, "deg": np.pi / 180, "m": 1.0, "mm": 1e-3}
_RANGED = ("normalised", "ticks")


@dataclass(frozen=True)
class BoundJointMap:
    """A joint map for one embodiment and one dataset.

    Attributes:
        embodiment: whose joints.
        column: (m,) the column of each independent joint; of those that are fixed or posed, any.
        scale, offset: (m,) rad or m.
        pose: of the end-effector, where it stands for the arm's joints.
        pose_columns: (k,) its columns.
    """

    embodiment: Embodiment
    column: Array
    scale: Array
    offset: Array
    pose: PoseMap | None = None
    pose_columns: Array = field(default_factory=lambda: np.array([], int))

    def qpos(self, values: Array) -> Array:
        """(T, k) columns to (T, n) joint positions, rad or m; of the arm only what is recorded."""
        return self.embodiment.coupled.expand(values[:, self.column] * self.scale + self.offset)


@dataclass(frozen=True)
class BoundJoint:
    """One independent joint of a group: `u[index] = scale * column + offset`."""

    index: int
    column: int
    scale: float
    offset: float


def bind(
    joint_map: JointMap, embodiment: Embodiment, columns: Sequence[str], where: str = "joint map"
) -> BoundJointMap:
    """Check a map of the state against an embodiment and a dataset.

    Args:
        joint_map: from a file.
        embodiment: whose joints it maps.
        columns: names of the dataset's columns; numbers stand for those without.
        where: the map's file, for messages.

    Raises:
        CEIError: an unknown joint or column, one that is named twice or not at all, or a wrong unit or number.
    """
    independent = independent_joints(embodiment)
    column = np.full(len(independent), -1)
    scale, offset = np.zeros(len(independent)), np.zeros(len(independent))
    posed = find_columns(joint_map.pose.columns, columns, where) if joint_map.pose else []
    if joint_map.pose:
        joint_map.pose.check(len(posed), where)
    if joint_map.fps is not None and not 0 < joint_map.fps < 10_000:
        raise CEIError(f"{where}: fps should be above 0, not {joint_map.fps:g}.")
    used = set(posed)
    for group in joint_map.joints:
        bound, chosen = bind_group(group, embodiment, columns, where)
        for joint in bound:
            if column[joint.index] >= 0:
                raise CEIError(f"{where}: joint {independent[joint.index]} is mapped twice.")
            column[joint.index], scale[joint.index], offset[joint.index] = joint.column, joint.scale, joint.offset
        used |= set(chosen)
    for joint, value in joint_map.fixed.items():
        if joint not in independent:
            raise CEIError(f"{where}: fixed: {unknown('independent joint', joint, independent)}")
        u = independent.index(joint)
        if column[u] >= 0:
            raise CEIError(f"{where}: joint {joint} is both mapped and fixed.")
        if not np.isfinite(value):
            raise CEIError(f"{where}: fixed: {joint} should be a finite number, not {value}.")
        column[u], offset[u] = 0, value
    by_pose = range(n_arm(embodiment)) if joint_map.pose else range(0)
    for u in by_pose:
        if column[u] >= 0:
            raise CEIError(
                f"{where}: joint {independent[u]} is mapped, but pose gives all of the arm's; leave one out."
            )
    missing = [joint for u, joint in enumerate(independent) if column[u] < 0 and u not in by_pose]
    if missing:
        raise CEIError(
            f"{where}: {embodiment.name} also has {', '.join(missing)}; map them, or say where they are in fixed."
        )
    check_ignored(joint_map.ignore, columns, used, where)
    column[list(by_pose)] = 0
    return BoundJointMap(embodiment, column, scale, offset, joint_map.pose, np.array(posed, int))


def independent_joints(embodiment: Embodiment) -> list[str]:
    """Names of the joints that follow no other, arm then end-effector."""
    return [embodiment.joint_names[q] for q in embodiment.coupled.independent]


def n_arm(embodiment: Embodiment) -> int:
    """How many of these are the arm's."""
    return int(sum(q < embodiment.n_arm for q in embodiment.coupled.independent))


def bind_group(
    group: JointGroup, embodiment: Embodiment, columns: Sequence[str], where: str
) -> tuple[list[BoundJoint], list[int]]:
    """A group's independent joints, and the columns that it uses.

    Raises:
        CEIError: as `bind`.
    """
    joints, independent = find_joints(group.joints, embodiment, where), independent_joints(embodiment)
    lower, upper = embodiment.independent_limits
    if group.columns is None:
        raise CEIError(f"{where}: {_listed(joints)}: say which columns, by columns: [...].")
    chosen = find_columns(group.columns, columns, where)
    if len(joints) != len(chosen):
        raise CEIError(f"{where}: {len(joints)} joints ({', '.join(joints)}) but {len(chosen)} columns.")
    signs = _each(group.sign, joints, f"{where}: sign")
    shifts = _each(group.offset, joints, f"{where}: offset")
    bound = []
    for joint, c, sign, shift in zip(joints, chosen, signs, shifts, strict=True):
        if joint not in independent:  # follows another
            continue
        if sign not in (1, -1):
            raise CEIError(f"{where}: sign of {joint} should be 1 or -1, not {sign:g}.")
        u = independent.index(joint)
        unit = embodiment.joint_units[embodiment.joint_names.index(joint)]
        factor, zero = _to_si(group, unit, joint, (lower[u], upper[u]), where)
        bound.append(BoundJoint(u, c, sign * factor, sign * zero + shift))
    return bound, chosen


def find_joints(joints: list[str] | str, embodiment: Embodiment, where: str) -> list[str]:
    """Names of joints that are given as a list, `arm` or `end_effector`.

    Raises:
        CEIError: there is no such joint.
    """
    if isinstance(joints, list):
        for joint in joints:
            if joint not in embodiment.joint_names:
                raise CEIError(f"{where}: {unknown(f'joint of {embodiment.name}', joint, embodiment.joint_names)}")
        return joints
    if joints not in (ARM, END_EFFECTOR):
        raise CEIError(f"{where}: joints should be a list, arm or end_effector, not {joints!r}.")
    names, arm = independent_joints(embodiment), n_arm(embodiment)
    return names[:arm] if joints == ARM else names[arm:]


def find_columns(chosen: Span | Sequence[str], columns: Sequence[str], where: str) -> list[int]:
    """Numbers of columns that are given as names, numbers or {start, end}.

    Raises:
        CEIError: there is no such column.
    """
    if isinstance(chosen, Span):
        if not 0 <= chosen.start < chosen.end <= len(columns):
            raise CEIError(
                f"{where}: columns {chosen.start} to {chosen.end}: it should be 0 <= start < end <= {len(columns)}."
            )
        return list(range(chosen.start, chosen.end))
    found = []
    for name in chosen:
        number = int(name) if name.isdecimal() and len(name) < 10 else -1
        if name not in columns and not 0 <= number < len(columns):
            raise CEIError(f"{where}: {unknown('column', name, columns)}")
        if columns.count(name) > 1:
            raise CEIError(f"{where}: several columns are named {name!r}; give their numbers, from 0.")
        found.append(columns.index(name) if name in columns else number)
    return found


def check_ignored(ignore: list[str] | str, columns: Sequence[str], used: set[int], where: str) -> None:
    """Check that no column is overlooked.

    Raises:
        CEIError: naming those that are neither used nor ignored, or both.
    """
    if ignore == REST:
        return
    if isinstance(ignore, str):
        raise CEIError(f"{where}: ignore should be a list of columns or {REST!r}, not {ignore!r}.")
    ignored = set(find_columns(ignore, columns, where))
    if both := ignored & used:
        raise CEIError(f"{where}: ignore names {', '.join(columns[c] for c in sorted(both))}, which the map uses.")
    if left := set(range(len(columns))) - used - ignored:
        names = ", ".join(columns[c] for c in sorted(left))
        raise CEIError(
            f"{where}: columns {names} are neither used nor ignored; list them under ignore, or write ignore: {REST}."
        )


def _each(values: list[float] | float, joints: Sequence[str], where: str) -> list[float]:
    each = list(map(float, values)) if isinstance(values, list) else [float(values)] * len(joints)
    if len(each) != len(joints) or not np.isfinite(each).all():
        raise CEIError(f"{where} should be one number or {len(joints)}, not {values}.")
    return each


def _to_si(group: JointGroup, si_unit: str, joint: str, limits: tuple[float, float], where: str) -> tuple[float, float]:
    """Factor and zero: `rad or m = factor * stored + zero`."""
    if group.unit in _RANGED:
        stored = group.range or ([0.0, 1.0] if group.unit == "normalised" else None)
        if stored is None:
            raise CEIError(f"{where}: {joint}: ticks need range: [at the lower limit, at the upper limit].")
        reached = group.limits or list(limits)
        for name, pair in (("range", stored), ("limits", reached)):
            if len(pair) != 2 or not np.isfinite(pair).all() or pair[0] == pair[1]:
                raise CEIError(f"{where}: {joint}: {name} should be two different finite numbers, not {pair}.")
        factor = (reached[1] - reached[0]) / (stored[1] - stored[0])
        return factor, reached[0] - factor * stored[0]
    if group.unit not in _PER_SI:
        raise CEIError(f"{where}: {joint}: {unknown('unit', group.unit, (*_PER_SI, *_RANGED))}")
    if group.range is not None or group.limits is not None:
        raise CEIError(f"{where}: {joint}: range and limits are for {' and '.join(_RANGED)}, not for {group.unit}.")
    if group.unit != SI and (group.unit in ("m", "mm")) != (si_unit == "m"):
        raise CEIError(f"{where}: {joint} is in {si_unit}; its columns cannot be in {group.unit}.")
    return _PER_SI[group.unit], 0.0


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)
