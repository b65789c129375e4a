"""What is wrong with a dataset's columns, in plain words, and which joints they may be."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cei_converters.sources.binding import bind
from cei_converters.sources.joint_map import JointMap
from cei_converters.sources.recording import Recordings
from cei_gym.embodiment import Embodiment

_MOST_LAG = 10  # frames
_SPEED_SLACK = 1.5  # a recorded velocity is a difference of noisy positions
_WORDS = {
    "deg": "degrees",
    "ticks": "servo ticks",
    "mm": "millimetres",
}


@dataclass(frozen=True)
class Column:
    """One column over the episodes that were read.

    Attributes:
        name: of it.
        least, largest: finite values.
        fastest: largest change of one frame to the next, a second; None without fps.
        missing: values that are not finite.
        constant: whether it never changes.
        unit: what its numbers look like: "rad", "deg", "ticks", or "" where they say nothing.
        lag: frames by which the state follows the action best, or None where it does not.
    """

    name: str
    least: float
    largest: float
    fastest: float | None
    missing: int
    constant: bool
    unit: str
    lag: int | None

    def row(self) -> dict[str, Any]:
        """For a table."""
        return {
            "column": self.name,
            "least": self.least,
            "largest": self.largest,
            "fastest a second": self.fastest,
            "not finite": self.missing or None,
            "constant": "yes" if self.constant else None,
            "looks like": self.unit or None,
            "lag": self.lag,
        }


def look_at(recordings: Recordings) -> list[Column]:
    """Every column's figures."""
    return [_column(recordings, i) for i in range(len(recordings.names))]


def _column(recordings: Recordings, i: int) -> Column:
    values = [recording.state[:, i] for recording in recordings.episodes]
    together = np.concatenate(values)
    finite = together[np.isfinite(together)]
    if not len(finite):
        return Column(recordings.names[i], np.nan, np.nan, None, len(together), True, "", None)
    steps = np.concatenate([np.abs(np.diff(v)) for v in values])
    fastest = np.nanmax(steps, initial=0.0) * recordings.fps if recordings.fps else None
    least, largest = float(finite.min()), float(finite.max())
    return Column(
        recordings.names[i],
        least,
        largest,
        None if fastest is None else float(fastest),
        len(together) - len(finite),
        bool(least == largest),
        _unit(finite),
        _lag(recordings, i),
    )


def _unit(values: np.ndarray) -> str:
    extent = np.abs(values).max()
    if extent > 400:
        return "ticks" if (values == np.rint(values)).all() else ""
    if extent > 2 * np.pi + 0.5:
        return "deg"
    return "rad" if extent > 1.2 else ""


def _lag(recordings: Recordings, i: int) -> int | None:
    """Frames between a target and the state that is most like it."""
    pairs = [(r.state[:, i], r.action[:, i]) for r in recordings.episodes if r.action is not None]
    if not pairs or not all(np.isfinite(a).all() and np.isfinite(s).all() for s, a in pairs):
        return None
    errors = []
    for lag in range(_MOST_LAG + 1):
        differences = [np.abs(s[lag:] - a[: len(a) - lag]) for s, a in pairs if len(s) > 2 * _MOST_LAG]
        if not differences:
            return None
        errors.append(np.concatenate(differences).mean())
    extent = np.ptp(np.concatenate([s for s, _ in pairs]))
    return int(np.argmin(errors)) if extent > 0 and min(errors) < 0.1 * extent else None


def problems(recordings: Recordings, columns: Sequence[Column]) -> list[str]:
    """What is wrong, one sentence each."""
    found = []
    for column in columns:
        if column.missing:
            found.append(
                f"{column.name} has {column.missing} values that are not finite; such episodes do not convert."
            )
        if column.unit in _WORDS:
            found.append(
                f"{column.name} looks like {_WORDS[column.unit]}; its group in a joint map needs unit: {column.unit}."
            )
    if still := [column.name for column in columns if column.constant]:
        found.append(f"never changes: {_listed(still)}; not recorded, or not used.")
    moving = [column for column in columns if not column.constant]
    if any(recording.action is None for recording in recordings.episodes):
        found.append("actions are not of the same columns as the state; a joint map needs action: null.")
    elif strange := [column.name for column in moving if column.lag is None]:
        found.append(
            f"the state does not follow the action: {_listed(strange)}; it may be a velocity, a difference or a command to a gripper "
            "(then action: null), or stay short of its target by contact."
        )
    if recordings.fps is None:
        found.append("nothing says how many frames a second there are; a joint map needs fps.")
    else:
        found += _about_time(recordings)
    return found


def _about_time(recordings: Recordings) -> list[str]:
    assert recordings.fps is not None
    for index, recording in enumerate(recordings.episodes):
        if recording.times_s is None or len(recording.times_s) < 2:
            continue
        steps = np.diff(recording.times_s)
        if (wrong := np.flatnonzero(np.abs(steps * recordings.fps - 1) > 0.5)).size:
            return [
                f"time stamps and fps disagree: frame {wrong[0] + 1} of the {index + 1}. episode read comes {steps[wrong[0]]:.4g} s after "
                f"the last, at {recordings.fps:g} frames a second."
            ]
    return []


def propose(recordings: Recordings, columns: Sequence[Column], embodiment: Embodiment) -> dict[str, Any] | None:
    """A joint map as plain values: by names where they are the joints', else where limits fit best; None where nothing does."""
    groups = []
    start = 0
    independent = embodiment.coupled.independent
    for part, joints in (
        ("arm", [q for q in independent if q < embodiment.n_arm]),
        ("end_effector", [q for q in independent if q >= embodiment.n_arm]),
    ):
        names = [embodiment.joint_names[q] for q in joints]
        by_name = [_named(name, recordings.names) for name in names]
        if all(i is not None for i in by_name):
            chosen: Any = [recordings.names[i] for i in by_name if i is not None]
            unit = columns[by_name[0] or 0].unit
        elif (found := _fitting(columns, embodiment, joints, start)) is not None:
            start, unit = found[0] + len(joints), found[1]
            chosen = {"start": found[0], "end": start}
        else:
            return None
        unit = {} if unit in ("", "rad") else {"unit": unit} | ({"range": [0, 4095]} if unit == "ticks" else {})
        groups.append({"joints": part, "columns": chosen, **unit})
    proposal = {"embodiment": embodiment.name, "joints": groups, "ignore": "rest"}
    if any(recording.action is None for recording in recordings.episodes):
        proposal["action"] = None
    return proposal


def _named(joint: str, names: Sequence[str]) -> int | None:
    """The column that is named after a joint, maybe with an ending such as `.pos`."""
    plain = [name.removeprefix("observation.state.").partition(".pos")[0] for name in names]
    return plain.index(joint) if plain.count(joint) == 1 else None


def _fitting(
    columns: Sequence[Column], embodiment: Embodiment, joints: Sequence[int], start: int
) -> tuple[int, str] | None:
    """First of as many neighbours as there are joints whose values are most within the joints' limits, and their unit."""
    best, least = None, np.inf
    for unit, factor in (("rad", 1.0), ("deg", np.pi / 180)):
        for first in range(start, len(columns) - len(joints) + 1):
            window = columns[first : first + len(joints)]
            if all(column.constant for column in window) or (unit == "deg") > any(
                column.unit == "deg" for column in window
            ):
                continue
            outside = still = 0.0
            for column, q in zip(window, joints, strict=True):
                low, high = embodiment.lower[q], embodiment.upper[q]
                below, above = low - column.least * factor, column.largest * factor - high
                outside += max(0.0, below, above) / (high - low)
                still += column.constant
            if (cost := outside + 0.1 * still) < least:
                best, least = (first, unit), cost
    return best if least < 0.5 * len(joints) else None


def check_map(recordings: Recordings, mapped: JointMap, embodiment: Embodiment) -> list[str]:
    """What is wrong with joints that a map makes of the columns.

    Raises:
        CEIError: the map is wrong in itself.
    """
    bound, found = bind(mapped, embodiment, recordings.names), []
    for q, joint in enumerate(embodiment.joint_names):
        if q not in embodiment.coupled.independent or (bound.pose is not None and q < embodiment.n_arm):
            continue
        values = [bound.qpos(recording.state)[:, q] for recording in recordings.episodes]
        together, unit = np.concatenate(values), embodiment.joint_units[q]
        slack = 0.02 * (embodiment.upper[q] - embodiment.lower[q])
        outside = (together < embodiment.lower[q] - slack) | (together > embodiment.upper[q] + slack)
        if outside.any():
            found.append(
                f"{joint} is outside its limits [{embodiment.lower[q]:.4g}, {embodiment.upper[q]:.4g}] {unit} in "
                f"{100 * outside.mean():.3g} % of the frames, from {together.min():.4g} to {together.max():.4g}: the wrong column, unit, sign "
                "or offset, or a finger that is pressed."
            )
        if recordings.fps:
            fastest = max(np.abs(np.diff(v)).max(initial=0.0) for v in values) * recordings.fps
            if fastest > _SPEED_SLACK * embodiment.max_velocity[q]:
                found.append(
                    f"{joint} moves at {fastest:.3g} {unit}/s, and can do {embodiment.max_velocity[q]:.3g}: the wrong unit or fps, or a jump."
                )
    return found


def _listed(names: Sequence[str], most: int = 8) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
