"""A joint map: which columns of a dataset are which joints of an embodiment, and in what unit."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cei_converters.sources.pose import PoseMap, Span
from cei_gym.embodiment import Embodiment, load_spec
from cei_gym.errors import CEIError, unknown

FORMAT = """a joint map (of a dataset whose columns are not named after an embodiment's joints):
  embodiment: Panda-PandaGripper  # --source may say it instead
  state: observation.state
  action: action  # absolute targets in the same columns; or null: the next frame's state
  fps: 20  # of formats that do not say it
  joints:
    - joints: [joint1, joint2, joint3, joint4, joint5, joint6, joint7]  # or arm, or end_effector: its independent joints
      columns: {start: 0, end: 7}  # or a list of names or numbers
      unit: deg  # or mm, normalised, ticks; default: rad or m, as the joint is
      sign: [1, 1, -1, 1, 1, 1, 1]  # or one for all
      offset: 0.1  # added after all else, rad or m
    - joints: [finger_joint1, finger_joint2]
      columns: [gripper, gripper]
      unit: normalised
      range: [0, 1]  # what is stored where the joint is at its two limits (of ticks: required)
      limits: [0, 0.04]  # these, if not the embodiment's; rad or m
  fixed: {joint8: 0.5}  # joints that are not recorded, rad or m
  ignore: rest  # or a list of columns: so that none is overlooked"""
_SI = "si"
_PER_SI = {_SI: 1.0, "rad": 1.0, "deg": np.pi / 180, "m": 1.0, "mm": 1e-3}
_RANGED = ("normalised", "ticks")
_REST = "rest"


@dataclass(frozen=True)
class JointGroup:
    """Joints that are stored alike; see `FORMAT`."""

    joints: list[str] | str
    columns: Span | list[str]
    unit: str = _SI
    sign: list[float] | float = 1.0
    offset: list[float] | float = 0.0
    range: list[float] | None = None
    limits: list[float] | None = None


@dataclass(frozen=True)
class JointMap:
    """What a YAML file says; see `FORMAT`, and `PoseMap` for `pose`."""

    joints: list[JointGroup]
    embodiment: str | None = None
    state: str = "observation.state"
    action: str | None = "action"
    fps: float | None = None
    pose: PoseMap | None = None
    fixed: dict[str, float] = field(default_factory=dict)
    ignore: list[str] | str = field(default_factory=list)


@dataclass(frozen=True)
class BoundJointMap:
    """A joint map for one embodiment and one dataset: `u = scale * column + offset`.

    Attributes:
        embodiment: whose joints.
        column: (m,) the column of each independent joint, or -1.
        scale, offset: (m,) rad or m.
        pose: of the end-effector, where it stands for the arm's joints.
        pose_columns: (k,) its columns.
    """

    embodiment: Embodiment
    column: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    pose: PoseMap | None = None
    pose_columns: np.ndarray = field(default_factory=lambda: np.array([], int))

    def qpos(self, values: np.ndarray) -> np.ndarray:
        """(T, k) columns to (T, n) joint positions, rad or m; of the arm only what is recorded."""
        return self.embodiment.coupled.expand(values[:, self.column] * self.scale + self.offset)

    def targets(self, values: np.ndarray) -> np.ndarray:
        """The same of targets: servos that are sent past a joint's limits stop there."""
        return np.clip(self.qpos(values), self.embodiment.lower, self.embodiment.upper)


def load_joint_map(path: str | Path) -> JointMap:
    """Read a joint map; see `FORMAT`.

    Raises:
        CEIError: naming the file and the field.
    """
    return load_spec(JointMap, Path(path))


def bind(
    joint_map: JointMap, embodiment: Embodiment, columns: Sequence[str], where: str = "joint map"
) -> BoundJointMap:
    """Check a map against an embodiment and a dataset.

    Args:
        joint_map: from a file.
        embodiment: whose joints it maps.
        columns: names of the dataset's columns; numbers stand for those without.
        where: the map's file, for messages.

    Raises:
        CEIError: an unknown joint or column, one that is named twice or not at all, or a wrong unit or number.
    """
    coupled = embodiment.coupled
    independent = [embodiment.joint_names[q] for q in coupled.independent]
    lower, upper = embodiment.independent_limits
    column = np.full(len(independent), -1)
    scale, offset = np.zeros(len(independent)), np.zeros(len(independent))
    posed = _columns(joint_map.pose.columns, columns, where) if joint_map.pose else []
    if joint_map.pose:
        joint_map.pose.check(len(posed), where)
    if joint_map.fps is not None and not 0 < joint_map.fps < 10_000:
        raise CEIError(f"{where}: fps should be above 0, not {joint_map.fps:g}.")
    used = set(posed)
    for group in joint_map.joints:
        joints = _joints(group.joints, embodiment, where)
        chosen = _columns(group.columns, columns, where)
        if len(joints) != len(chosen):
            raise CEIError(f"{where}: {len(joints)} joints ({', '.join(joints)}) but {len(chosen)} columns.")
        signs = _each(group.sign, joints, f"{where}: sign")
        shifts = _each(group.offset, joints, f"{where}: offset")
        for joint, c, sign, shift in zip(joints, chosen, signs, shifts, strict=True):
            q = embodiment.joint_names.index(joint)
            if joint not in independent:  # follows another
                continue
            u = independent.index(joint)
            if column[u] >= 0:
                raise CEIError(f"{where}: joint {joint} is mapped twice.")
            if sign not in (1, -1):
                raise CEIError(f"{where}: sign of {joint} should be 1 or -1, not {sign:g}.")
            factor, zero = _to_si(group, embodiment.joint_units[q], joint, (lower[u], upper[u]), where)
            column[u], scale[u], offset[u] = c, sign * factor, sign * zero + shift
        used |= set(chosen)
    for joint, value in joint_map.fixed.items():
        if joint not in independent:
            raise CEIError(f"{where}: fixed: {unknown('independent joint', joint, independent)}")
        u = independent.index(joint)
        if column[u] >= 0:
            raise CEIError(f"{where}: joint {joint} is both mapped and fixed.")
        column[u], offset[u] = 0, value
    n_arm = sum(q < embodiment.n_arm for q in coupled.independent)
    by_pose = range(n_arm) if joint_map.pose else range(0)
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
    _check_ignored(joint_map, columns, used, where)
    column[list(by_pose)] = 0
    return BoundJointMap(embodiment, column, scale, offset, joint_map.pose, np.array(posed, int))


def _joints(joints: list[str] | str, embodiment: Embodiment, where: str) -> list[str]:
    if isinstance(joints, list):
        for joint in joints:
            if joint not in embodiment.joint_names:
                raise CEIError(f"{where}: {unknown(f'joint of {embodiment.name}', joint, embodiment.joint_names)}")
        return joints
    if joints not in ("arm", "end_effector"):
        raise CEIError(f"{where}: joints should be a list, arm or end_effector, not {joints!r}.")
    return [
        embodiment.joint_names[q] for q in embodiment.coupled.independent if (q < embodiment.n_arm) == (joints == "arm")
    ]


def _columns(chosen: Span | Sequence[str], columns: Sequence[str], where: str) -> list[int]:
    """Numbers of columns that are given as names, numbers or {start, end}."""
    if isinstance(chosen, Span):
        if not 0 <= chosen.start < chosen.end <= len(columns):
            raise CEIError(
                f"{where}: columns {chosen.start} to {chosen.end}: it should be 0 <= start < end <= {len(columns)}."
            )
        return list(range(chosen.start, chosen.end))
    found = []
    for name in chosen:
        number = int(name) if name.isdecimal() else -1
        if name not in columns and not 0 <= number < len(columns):
            raise CEIError(f"{where}: {unknown('column', name, columns)}")
        found.append(columns.index(name) if name in columns else number)
    return found


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
    if group.unit != _SI and (group.unit in ("m", "mm")) != (si_unit == "m"):
        raise CEIError(f"{where}: {joint} is in {si_unit}; its columns cannot be in {group.unit}.")
    return _PER_SI[group.unit], 0.0


def _check_ignored(joint_map: JointMap, columns: Sequence[str], used: set[int], where: str) -> None:
    if joint_map.ignore == _REST:
        return
    if isinstance(joint_map.ignore, str):
        raise CEIError(f"{where}: ignore should be a list of columns or {_REST!r}, not {joint_map.ignore!r}.")
    ignored = set(_columns(joint_map.ignore, columns, where))
    if both := ignored & used:
        raise CEIError(f"{where}: ignore names {', '.join(columns[c] for c in sorted(both))}, which the map uses.")
    if left := set(range(len(columns))) - used - ignored:
        names = ", ".join(columns[c] for c in sorted(left))
        raise CEIError(
            f"{where}: columns {names} are neither used nor ignored; list them under ignore, or write ignore: {_REST}."
        )
