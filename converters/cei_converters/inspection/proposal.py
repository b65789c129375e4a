"""A joint map for columns that nobody has explained yet: only where it is well founded, else what is in doubt."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cei_converters.dataset.schema import words
from cei_converters.inspection.columns import DEGREES, HUNDRED, PERCENT, TICKS, Column
from cei_converters.sources.binding import ARM, END_EFFECTOR, bind, independent_joints, n_arm
from cei_converters.sources.joint_map import JointMap
from cei_gym.embodiment import Embodiment

_SIDES = {"left": "left", "l": "left", "right": "right", "r": "right"}
_NO_WORDS = frozenset(
    [
        "joint",
        "joints",
        "pos",
        "position",
        "positions",
        "motor",
        "motors",
        "observation",
        "state",
        "action",
        "rad",
        "m",
        "deg",
        "k",
        "link",
        "servo",
        "main",
    ]
)
_HAND = frozenset(
    [
        "hand",
        "gripper",
        "grip",
        "jaw",
        "finger",
        "fingers",
        "claw",
        "thumb",
        "index",
        "middle",
        "ring",
        "pinky",
        "little",
    ]
)
_SLACK = 0.03  # of a joint's range
_LEAST_MOTION = 0.05  # of a joint's range, for a column to say anything
_WIDTH = (1.5, 2.5)  # times its upper limit: a column that has the distance of two fingers instead of one's position


@dataclass(frozen=True)
class Proposal:
    """A joint map as plain values, or None, and what is in doubt, one sentence each."""

    joint_map: dict[str, Any] | None
    doubts: list[str] = field(default_factory=list[str])


@dataclass(frozen=True)
class _Part:
    """An arm or end-effector: its independent joints, and names that say which side it is of."""

    name: str
    joints: list[int]
    names: list[str]


def propose(columns: Sequence[Column], embodiment: Embodiment) -> Proposal:
    """A joint map: by names where they are the joints', else where limits fit, if they fit at one place only.

    Args:
        columns: the state's.
        embodiment: whose joints they may be.
    """
    independent, arm = embodiment.coupled.independent, n_arm(embodiment)
    names = independent_joints(embodiment)
    parts = [
        _Part(ARM, [int(q) for q in independent[:arm]], names[:arm]),
        _Part(END_EFFECTOR, [int(q) for q in independent[arm:]], names[arm:]),
    ]
    side = _side([embodiment.name, *embodiment.joint_names])
    groups: list[dict[str, Any]] = []
    doubts: list[str] = []
    taken: set[int] = set()
    for part in parts:
        if not part.joints:
            continue
        found = _by_name(part, columns, embodiment, side, taken)
        if isinstance(found, str):
            doubts.append(found)
            continue
        if found is None:
            found = _by_limits(part, columns, embodiment, side, taken)
        if isinstance(found, str):
            doubts.append(found)
            continue
        unit = _unit(part, [columns[i] for i in found], embodiment)
        if isinstance(unit, str):
            doubts.append(unit)
            continue
        taken |= set(found)
        groups.append({"joints": part.name, "columns": _chosen(found, columns), **unit})
    if doubts:
        known = [f"{group['joints']} is {_in_words(group['columns'])} by its names or limits" for group in groups]
        return Proposal(
            None, [*dict.fromkeys(doubts), *(f"so no joint map is proposed; of it, {text}." for text in known)]
        )
    return Proposal({"embodiment": embodiment.name, "joints": groups, "ignore": "rest"})


def _by_name(
    part: _Part, columns: Sequence[Column], embodiment: Embodiment, side: str, taken: set[int]
) -> list[int] | str | None:
    """Columns that are named after the joints; None where they are not."""
    found = []
    for joint in part.names:
        own = [
            i for i, column in enumerate(columns) if i not in taken and _is(column.name, joint, embodiment.joint_names)
        ]
        if not own:
            return None
        fitting = [i for i in own if _side([columns[i].name]) in ("", side)] if side else own
        if len(fitting) != 1:
            names = ", ".join(columns[i].name for i in own)
            return f"{joint} may be any of {names}; a joint map has to say which."
        found += fitting
    return found if len(set(found)) == len(found) else None


def _is(column: str, joint: str, joints: Sequence[str]) -> bool:
    """Whether a column's name says a joint's: the same words in whatever spelling, or the joint's at its end.

    Where the end is also that of a longer one of the robot's `joints`, it is that joint's: finger_joint1 is not joint1.
    """
    ours, stem = _told(joint), column.partition(".pos")[0]
    ends = [name for name in joints if stem == name or stem.endswith(("_" + name, "." + name))]
    return bool(ours) and (ours == _told(column) or joint == max(ends, key=len, default=None))


def _told(name: str) -> frozenset[str]:
    apart = words(name)
    apart = apart[1:] if len(apart) > 1 and apart[0] == "k" else apart  # as Unitree has constants
    told = {_SIDES.get(word, word) for word in apart if word not in _NO_WORDS}
    if all(word.isdecimal() for word in told):  # a motor of the same number is another matter: some count from 0
        told |= set(apart) & {"joint"}
    return frozenset(told)


def _side(names: Sequence[str]) -> str:
    """Left or right, where all names that say anything say the same."""
    said = {_SIDES[word] for name in names for word in words(name) if word in _SIDES}
    return said.pop() if len(said) == 1 else ""


def _by_limits(
    part: _Part, columns: Sequence[Column], embodiment: Embodiment, side: str, taken: set[int]
) -> list[int] | str:
    """The only neighbouring columns whose values are within the joints' limits; else what is in doubt."""
    sides = {_side([column.name]) for column in columns} - {""}
    if len(sides) > 1 and not side:
        return f"columns are of a left and a right side, and nothing says which {embodiment.name} is: name its joints' side, or write the map."
    size, places = len(part.joints), []
    for first in range(len(columns) - size + 1):
        window = range(first, first + size)
        if taken & set(window):
            continue
        if side and any(_side([columns[i].name]) not in ("", side) for i in window):
            continue
        if len(sides) > 1 and any(_side([columns[i].name]) != side for i in window):
            continue
        if _fits([columns[i] for i in window], part.joints, embodiment):
            places.append(list(window))
    what = f"the {part.name.replace('_', '-')} of {embodiment.name} ({size} joints)"
    named = [c for i, c in enumerate(columns) if _may_be(c, part, side) and i not in taken]
    if not places and size == 1 and len(named) == 1 and (text := _wide(named[0], part.joints[0], embodiment)):
        return text
    if not places and named:
        return (
            f"{what} may be {', '.join(c.name for c in named[:8])}: they are not within its joints' limits in rad or m, and their unit nothing here says. Write which is "
            "which, with unit: normalised and range: [what is stored at the lower limit, at the upper limit], or what they are."
        )
    if not places:
        return f"no {size} neighbouring columns are within the limits of {what}, and none are named after its joints; is it the right robot?"
    if len(places) > 1:
        at = ", ".join(
            f"{columns[window[0]].name} to {columns[window[-1]].name}" if size > 1 else columns[window[0]].name
            for window in places[:4]
        )
        more = f" and {len(places) - 4} more" if len(places) > 4 else ""
        return f"{what} may be columns {at}{more}: all are within its limits, and names say nothing; a joint map has to say which."
    return places[0]


def _fits(window: Sequence[Column], joints: Sequence[int], embodiment: Embodiment) -> bool:
    factor = np.pi / 180 if all(column.unit == DEGREES or column.constant for column in window) else 1.0
    if factor == 1.0 and any(column.unit in (DEGREES, HUNDRED, PERCENT, TICKS) for column in window):
        return False
    moving = 0
    for column, q in zip(window, joints, strict=True):
        low, high = embodiment.lower[q], embodiment.upper[q]
        slack = _SLACK * (high - low)
        if not low - slack <= column.least * factor <= column.largest * factor <= high + slack:
            return False
        moving += (column.largest - column.least) * factor > _LEAST_MOTION * (high - low)
    return moving >= max(1, len(joints) // 2)


def _unit(part: _Part, columns: Sequence[Column], embodiment: Embodiment) -> dict[str, Any] | str:
    """What a group says of its unit; else what is in doubt."""
    units, names = {column.unit for column in columns}, ", ".join(column.name for column in columns[:6])
    if TICKS in units:
        return f"{names} look like servo ticks; what is stored at the joints' limits, nothing here says: write unit: ticks, range: [...]."
    if HUNDRED in units:
        return (
            f"{names} are degrees, or LeRobot's normalised -100 to 100: the recording robot's use_degrees says which, nothing here does. Write unit: deg, "
            "or unit: normalised, range: [-100, 100], and limits: [...] as they were calibrated."
        )
    if PERCENT in units:
        return f"{names} look like 0 to 100; whether 0 is open or closed, nothing here says: write unit: normalised, range: [at the lower limit, at the upper limit]."
    if DEGREES in units:
        return {"unit": "deg"}
    if part.name == END_EFFECTOR:
        wide = [_wide(column, q, embodiment) for column, q in zip(columns, part.joints, strict=True)]
        return next(filter(None, wide), {})
    return {}


def _wide(column: Column, q: int, embodiment: Embodiment) -> str:
    """What is in doubt of a column that goes farther than a finger; empty where nothing is."""
    upper, joint = float(embodiment.upper[q]), embodiment.joint_names[q]
    if embodiment.joint_units[q] != "m" or column.least < -0.01 * upper or column.largest < _WIDTH[0] * upper:
        return ""
    if column.largest < _WIDTH[1] * upper:
        return (
            f"{column.name} goes up to {column.largest:.3g}, about twice the {upper:.3g} m of {joint}: the distance of two fingers? Then write "
            f"unit: normalised, range: [0, {2 * upper:.3g}]."
        )
    return (
        f"{column.name} goes up to {column.largest:.3g}, where {joint} goes to {upper:.3g} m; write its unit and range: what is stored at the lower "
        "and at the upper limit."
    )


def _chosen(found: Sequence[int], columns: Sequence[Column]) -> Any:
    """As a map has them: by name where names are, else as neighbours."""
    names = [columns[i].name for i in found]
    if not any(name.isdecimal() for name in names) and len(set(names)) == len(names) and not _neighbours(found):
        return names
    return {"start": found[0], "end": found[-1] + 1} if _neighbours(found) else names


def _in_words(columns: Any) -> str:
    return f"columns {columns['start']} to {columns['end'] - 1}" if isinstance(columns, dict) else ", ".join(columns)


def _may_be(column: Column, part: _Part, side: str) -> bool:
    """Whether a column is a hand's or gripper's by its name, of the right side."""
    return part.name == END_EFFECTOR and _side([column.name]) in ("", side) and bool(_HAND & set(words(column.name)))


def wrong_sides(joint_map: JointMap, embodiment: Embodiment, columns: Sequence[str]) -> list[str]:
    """Columns of one side that a map takes for joints of the other.

    Raises:
        CEIError: the map is wrong in itself.
    """
    bound = bind(joint_map, embodiment, columns)
    used = zip(independent_joints(embodiment), bound.column.tolist(), bound.scale, strict=True)
    taken = [(joint, str(columns[c])) for joint, c, scale in used if scale]
    other = [
        f"{column} to {joint}" for joint, column in taken if {_side([column]), _side([joint])} == {"left", "right"}
    ]
    return [f"columns of one side are mapped to joints of the other: {', '.join(other)}."] if other else []


def _neighbours(found: Sequence[int]) -> bool:
    return list(found) == list(range(found[0], found[-1] + 1))
