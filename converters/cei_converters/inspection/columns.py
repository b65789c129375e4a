"""Figures of a dataset's columns, and what their numbers may be."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cei_converters.dataset import schema
from cei_converters.sources.recording import Recordings
from cei_gym.arrays import Array

DEGREES, TICKS, RADIANS, HUNDRED, PERCENT = "deg", "ticks", "rad", "deg or -100..100", "0..100"
_MOST_LAG = 10  # frames
_GRIPS = frozenset(["gripper", "grip", "jaw", "finger", "fingers", "claw"])


@dataclass(frozen=True)
class Column:
    """One column over the episodes that were read.

    Attributes:
        name: of it.
        least, largest: finite values.
        fastest: largest change of one frame to the next, a second; None without fps.
        missing: values that are not finite.
        constant: whether it never changes.
        unit: what its numbers look like: one of those above, or "" where they say nothing.
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
    units = _units([finite(recordings, i) for i in range(len(recordings.names))], recordings.names)
    return [_column(recordings, i, unit) for i, unit in enumerate(units)]


def finite(recordings: Recordings, i: int) -> Array:
    """All finite values of a column."""
    values = np.concatenate([recording.state[:, i] for recording in recordings.episodes])
    return values[np.isfinite(values)]


def is_grip(name: str) -> bool:
    """Whether a column's name says that it is a gripper's."""
    return bool(_GRIPS & set(schema.words(name)))


def _column(recordings: Recordings, i: int, unit: str) -> Column:
    values, name = finite(recordings, i), recordings.names[i]
    count = sum(len(recording.state) for recording in recordings.episodes)
    if not len(values):
        return Column(name, np.nan, np.nan, None, count, True, "", None)
    steps = np.concatenate([np.abs(np.diff(recording.state[:, i])) for recording in recordings.episodes])
    fastest = float(np.nanmax(steps, initial=0.0) * recordings.fps) if recordings.fps else None
    least, largest = float(values.min()), float(values.max())
    return Column(name, least, largest, fastest, count - len(values), least == largest, unit, _lag(recordings, i))


def _units(values: Sequence[Array], names: Sequence[str]) -> list[str]:
    """What each column's numbers look like. Those of one recorder are of one kind: more than 100 anywhere says degrees of all."""
    largest = [float(np.abs(v).max(initial=0.0)) for v in values]
    whole = [bool(len(v)) and bool((v == np.rint(v)).all()) for v in values]
    arm = [extent for extent, name in zip(largest, names, strict=True) if not is_grip(name)]
    degrees = any(101 < extent <= 400 for extent in arm)
    units = []
    for v, extent, ints, name in zip(values, largest, whole, names, strict=True):
        if extent > 400:
            units.append(TICKS if ints else "")
        elif extent > 2 * np.pi + 0.5:
            if is_grip(name) and v.min() > -1 and extent <= 101:
                units.append(PERCENT)
            else:
                units.append(DEGREES if degrees or extent > 101 else HUNDRED)
        else:
            units.append(RADIANS if extent > 1.2 else "")
    return units


def _lag(recordings: Recordings, i: int) -> int | None:
    """Frames between a target and the state that is most like it."""
    if not recordings.same_columns:
        return None
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
