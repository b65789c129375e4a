"""What is wrong with a dataset's columns, in plain words."""

from collections.abc import Sequence

from cei_converters.inspection.columns import DEGREES, HUNDRED, PERCENT, TICKS, Column
from cei_converters.inspection.frames import look_at_frames
from cei_converters.sources.recording import Recordings


def problems(recordings: Recordings, columns: Sequence[Column], explained: bool) -> list[str]:
    """What is wrong, one sentence each.

    Args:
        recordings: the episodes.
        columns: their figures.
        explained: whether a joint map or names say what columns and actions are, so that no advice is wanted on that.
    """
    found = [
        f"{column.name} has {column.missing} values that are not finite; such episodes do not convert."
        for column in columns
        if column.missing
    ]
    if not explained:
        found += _units(columns) + _actions(recordings, columns)
        if still := [column.name for column in columns if column.constant]:
            found.append(f"never changes: {_listed(still)}; not recorded, or not used.")
        if recordings.fps is None:
            found.append("nothing says how many frames a second there are; a joint map needs fps.")
    return found + look_at_frames(recordings)


def _units(columns: Sequence[Column]) -> list[str]:
    """A sentence for all columns of a kind."""
    advice = {
        DEGREES: "look like degrees; their groups in a joint map need unit: deg.",
        TICKS: "look like servo ticks; their groups in a joint map need unit: ticks, and range: what is stored at the joints' limits.",
        HUNDRED: "are degrees, or LeRobot's normalised -100 to 100 (the recording robot's use_degrees says which); their groups in a joint map need "
        "unit: deg, or unit: normalised, range: [-100, 100] and limits as calibrated.",
        PERCENT: "look like a gripper's 0 to 100; their groups in a joint map need unit: normalised, range: what is stored at the lower and upper limit.",
    }
    named = {unit: [column.name for column in columns if column.unit == unit] for unit in advice}
    return [f"{_listed(names)}: {advice[unit]}" for unit, names in named.items() if names]


def _actions(recordings: Recordings, columns: Sequence[Column]) -> list[str]:
    if all(recording.action is None for recording in recordings.episodes):
        return []
    if not recordings.same_columns:
        return [
            f"actions have other columns than the state: {_listed(list(recordings.action_names))}; a joint map says under action what they are, or "
            "takes the next frame's state for them, by action: null."
        ]
    if strange := [column.name for column in columns if column.lag is None and not column.constant]:
        return [
            f"the state does not follow the action: {_listed(strange)}; it may be a velocity, a difference or a command to a gripper (a joint map "
            "says so by kind, under action), or stay short of its target by contact."
        ]
    return []


def _listed(names: Sequence[str], most: int = 8) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
