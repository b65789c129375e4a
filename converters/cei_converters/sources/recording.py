"""A dataset's columns as they are recorded, before anybody says which joints they are."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Recording:
    """One episode.

    Attributes:
        state: (T, k).
        action: (T, k) of the same columns, or None where actions are something else.
        times_s: (T,) when, or None.
    """

    state: np.ndarray
    action: np.ndarray | None = None
    times_s: np.ndarray | None = None


@dataclass(frozen=True)
class Recordings:
    """Some episodes of a dataset.

    Attributes:
        names: k columns.
        fps: as declared, or None.
        episodes: those that were read.
        total: how many there are.
    """

    names: list[str]
    fps: float | None
    episodes: list[Recording]
    total: int


def spread(total: int, most: int) -> list[int]:
    """At most so many of `range(total)`, far apart."""
    return sorted({round(i) for i in np.linspace(0, total - 1, most)})
