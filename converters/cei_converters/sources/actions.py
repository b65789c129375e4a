"""What recorded actions say: targets of joints, whatever they are given as."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cei_converters.sources.binding import (
    REST,
    BoundJoint,
    bind_group,
    check_ignored,
    find_columns,
    find_joints,
    independent_joints,
    n_arm,
)
from cei_converters.sources.joint_map import (
    ABSOLUTE,
    DELTA,
    KINDS,
    NEXT_STATE,
    OF_THE_FORMAT,
    OPEN_CLOSE,
    SI,
    VELOCITY,
    ActionGroup,
    ActionMap,
    JointMap,
)
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError, unknown

_UNDECIDED = 1e-6  # of a command between -1 (open) and 1 (close)


@dataclass(frozen=True)
class BoundActions:
    """What one feature's columns say of an embodiment's targets: `x = scale * column + offset`.

    Attributes:
        embodiment: whose joints.
        feature: where the columns are.
        kinds: m of `joint_map.KINDS`: x is a target, is added to the state, is a speed, or below 0 to open and above 0 to close.
        column: (m,) the column of each independent joint; of those without, any.
        scale, offset: (m,) rad or m, or of a command to open and close, none.
        as_it_is: whether columns are all joints' targets, followers included, in the embodiment's order.
    """

    embodiment: Embodiment
    feature: str
    kinds: tuple[str, ...]
    column: Array
    scale: Array
    offset: Array
    as_it_is: bool = False

    def relative(self, values: Array) -> Array:
        """(T, k) columns to (T, m) in rad or m, as far as that can be without knowing where zero is."""
        return values[:, self.column] * self.scale

    def absolute(self, values: Array) -> Array:
        """(T, k) columns to (T, m) in rad or m."""
        return self.relative(values) + self.offset

    def of_kind(self, kind: str) -> Array:
        """(m,) which joints' actions are of a kind."""
        return np.array([each == kind for each in self.kinds])

    def targets(self, values: Array, qpos: Array, fps: float) -> Array:
        """Targets, those by a map within the joints' limits: servos that are sent past them stop there.

        Args:
            values: (T, k) columns.
            qpos: (T, n) the state, rad or m.
            fps: frames a second.

        Returns:
            (T, n) rad or m.
        """
        if self.as_it_is:
            return values
        body = self.embodiment
        u = body.coupled.reduce(qpos)
        ahead = np.concatenate([u[1:], u[-1:]])
        moved = {
            ABSOLUTE: self.absolute(values),
            DELTA: u + self.relative(values),
            VELOCITY: u + self.relative(values) / fps,
            NEXT_STATE: ahead,
            OPEN_CLOSE: self._opened(self.absolute(values), ahead),
        }
        targets = np.select([self.of_kind(kind) for kind in KINDS], [moved[kind] for kind in KINDS])
        if not self.of_kind(NEXT_STATE).all():
            targets = np.clip(targets, *body.independent_limits)
        return body.coupled.expand(targets)

    def _opened(self, command: Array, ahead: Array) -> Array:
        """Where each joint is told to be; what is told neither stays told what it was before."""
        told = np.sign(np.where(np.abs(command) < _UNDECIDED, 0.0, command))
        last = np.maximum.accumulate(np.where(told != 0, np.arange(len(told))[:, None], -1), axis=0)
        told = np.where(last >= 0, np.take_along_axis(told, np.maximum(last, 0), axis=0), 0.0)
        home, closed = (self.embodiment.coupled.reduce(pose) for pose in (self.embodiment.home, self.embodiment.closed))
        return np.select(
            [told > 0, told < 0], [np.broadcast_to(closed, told.shape), np.broadcast_to(home, told.shape)], ahead
        )


def action_map(joint_map: JointMap, default: ActionMap | None) -> ActionMap | None:
    """What a joint map says of actions, completed by a format's default; None where the next frame's state stands for them."""
    said = joint_map.action
    if said == OF_THE_FORMAT:
        return default
    if isinstance(said, str):
        return ActionMap(feature=said)
    if said is not None and said.feature is None:
        return replace(said, feature=default.feature if default is not None else None)
    return said


def bind_actions(
    actions: ActionMap,
    embodiment: Embodiment,
    columns: Sequence[str],
    joint_map: JointMap | None = None,
    state_columns: Sequence[str] = (),
    where: str = "joint map",
) -> BoundActions:
    """Check what is said of actions against an embodiment and a dataset.

    Args:
        actions: with its feature.
        embodiment: whose joints it moves.
        columns: names of that feature's columns; numbers stand for those without.
        joint_map: of the state, whose groups are the default.
        state_columns: names of the state's columns.
        where: the map's file, for messages.

    Raises:
        CEIError: an unknown joint, column or kind, a joint that is named twice or not at all, or a wrong unit or number.
    """
    assert actions.feature is not None
    independent, where = independent_joints(embodiment), f"{where}: action"
    groups, ignore, place = actions.joints, actions.ignore, list(range(len(columns)))
    if groups is None:
        assert joint_map is not None
        groups = [ActionGroup(**vars(group)) for group in joint_map.joints]
        if not groups and joint_map.pose is None:  # the state's columns are the embodiment's joints
            groups = [ActionGroup(independent, [str(q) for q in embodiment.coupled.independent])]
        needed = [c for group in groups for c in find_columns(group.columns or [], state_columns, where)]
        place = _places_of_the_state(columns, state_columns, needed, actions.feature, where)
        columns = state_columns
        ignore = ignore or REST  # what is ignored of the state is here, too
    kinds: list[str | None] = [None] * len(independent)
    column, scale, offset = np.zeros(len(independent), int), np.ones(len(independent)), np.zeros(len(independent))
    used: set[int] = set()
    for group in groups:
        kind = group.kind or actions.kind
        if kind not in KINDS:
            raise CEIError(f"{where}: {unknown('kind', kind, KINDS)}")
        bound, chosen = _bind_group(group, kind, embodiment, columns, where)
        for joint in bound:
            if kinds[joint.index] is not None:
                raise CEIError(f"{where}: joint {independent[joint.index]} is mapped twice.")
            kinds[joint.index] = kind
            column[joint.index], scale[joint.index], offset[joint.index] = (
                place[joint.column],
                joint.scale,
                joint.offset,
            )
        used |= set(chosen)
    if joint_map is not None:  # where neither columns nor commands are to be had
        by_pose = independent[: n_arm(embodiment)] if joint_map.pose else []
        for joint in (*by_pose, *joint_map.fixed):
            kinds[independent.index(joint)] = kinds[independent.index(joint)] or NEXT_STATE
    if missing := [joint for joint, kind in zip(independent, kinds, strict=True) if kind is None]:
        raise CEIError(
            f"{where}: nothing is said of {', '.join(missing)}; map them, or write "
            f"- {{joints: [{', '.join(missing)}], kind: {NEXT_STATE}}}."
        )
    check_ignored(ignore, columns, used, where)
    return BoundActions(embodiment, actions.feature, tuple(k or NEXT_STATE for k in kinds), column, scale, offset)


def _bind_group(
    group: ActionGroup, kind: str, embodiment: Embodiment, columns: Sequence[str], where: str
) -> tuple[list[BoundJoint], list[int]]:
    if kind == NEXT_STATE:
        if group.columns is not None:
            raise CEIError(f"{where}: {NEXT_STATE} needs no columns; leave them out.")
        independent = independent_joints(embodiment)
        joints = [joint for joint in find_joints(group.joints, embodiment, where) if joint in independent]
        return [BoundJoint(independent.index(joint), 0, 1.0, 0.0) for joint in joints], []
    if kind == OPEN_CLOSE:
        return _bind_command(group, embodiment, columns, where)
    bound, chosen = bind_group(group, embodiment, columns, where)
    if kind != ABSOLUTE and np.any(group.offset):
        raise CEIError(
            f"{where}: offset is for {ABSOLUTE} actions; of {kind} ones it would move joints that are told to rest."
        )
    return bound, chosen


def _bind_command(
    group: ActionGroup, embodiment: Embodiment, columns: Sequence[str], where: str
) -> tuple[list[BoundJoint], list[int]]:
    """A command to open or close, in a column for all joints or one each: -1 where it is to open, 1 where it is to close."""
    joints, independent = find_joints(group.joints, embodiment, where), independent_joints(embodiment)
    chosen = [] if group.columns is None else find_columns(group.columns, columns, where)
    if len(chosen) not in (1, len(joints)):
        raise CEIError(
            f"{where}: {OPEN_CLOSE} needs one column, or one each of {', '.join(joints)}; not {len(chosen)}."
        )
    stored = group.range or [-1.0, 1.0]
    if len(stored) != 2 or not np.isfinite(stored).all() or stored[0] == stored[1]:
        raise CEIError(f"{where}: range of {OPEN_CLOSE} should be what is stored to open and to close, not {stored}.")
    if group.unit != SI or group.limits is not None or group.sign != 1 or np.any(group.offset):
        raise CEIError(f"{where}: {OPEN_CLOSE} takes columns and range only.")
    home, closed = (
        dict(zip(embodiment.joint_names, pose, strict=True)) for pose in (embodiment.home, embodiment.closed)
    )
    if all(home[joint] == closed[joint] for joint in joints):
        raise CEIError(
            f"{where}: {OPEN_CLOSE} moves none of {', '.join(joints)}: {embodiment.name} has the same pose open (home) and closed."
        )
    scale = 2 / (stored[1] - stored[0])
    each = chosen * len(joints) if len(chosen) == 1 else chosen
    bound = [
        BoundJoint(independent.index(joint), c, scale, -1 - scale * stored[0])
        for joint, c in zip(joints, each, strict=True)
        if joint in independent
    ]
    return bound, chosen


def _places_of_the_state(
    columns: Sequence[str], state_columns: Sequence[str], used: Sequence[int], feature: str, where: str
) -> list[int]:
    """Say for each of the state's columns which of the feature's it is: by name, or in turn where names have nothing in common; anything for
    those that are not used.

    Raises:
        CEIError: it has other columns.
    """
    own = "say which are which under action, with joints: of its own, or write action: null for the next frame's state"
    if list(columns) == list(state_columns):
        return list(range(len(columns)))
    shared = {name for name in columns if name in state_columns and not name.isdecimal()}  # a number is no name
    if not shared:
        if len(columns) != len(state_columns):
            raise CEIError(
                f"{where}: {feature} has {len(columns)} columns but the state has {len(state_columns)}; {own}."
            )
        return list(range(len(columns)))
    if other := [state_columns[c] for c in used if state_columns[c] not in shared]:
        raise CEIError(
            f"{where}: {feature} shares some columns with the state ({_some(shared)}), and has {_some(set(columns) - shared) or 'none'} where that has "
            f"{_some(other)}; {own}."
        )
    return [columns.index(name) if name in shared else -1 for name in state_columns]


def _some(names: Iterable[str]) -> str:
    names = sorted(names)
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")


def of_all_joints(embodiment: Embodiment, feature: str) -> BoundActions:
    """Absolute targets in a column for each joint, followers included, in the embodiment's order."""
    independent = embodiment.coupled.independent
    one = np.ones(len(independent))
    return BoundActions(embodiment, feature, (ABSOLUTE,) * len(one), independent, one, 0 * one, as_it_is=True)
