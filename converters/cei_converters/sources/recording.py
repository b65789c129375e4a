"""A dataset's columns as they are recorded, before anybody says which joints they are."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cei_converters.dataset.step_time import StepTime
from cei_gym.arrays import Array


@dataclass(frozen=True)
class Recording:
    """One episode.

    Attributes:
        index: of it, in the dataset.
        state: (T, k).
        action: (T, l), or None where there are none.
        times_s: (T,) when, or None.
        numbers: (T,) each frame's number as it is stored, or None.
    """

    index: int
    state: Array
    action: Array | None = None
    times_s: Array | None = None
    numbers: Array | None = None


@dataclass(frozen=True)
class Recordings:
    """Some episodes of a dataset.

    Attributes:
        names: k columns.
        action_names: l columns of the actions.
        fps: as declared, or None.
        episodes: those that were read.
        total: how many there are.
        step_time_s: how long steps took, if the dataset says so.
    """

    names: list[str]
    fps: float | None
    episodes: list[Recording]
    total: int
    action_names: Sequence[str] = field(default_factory=tuple)
    step_time_s: StepTime | None = None

    @property
    def same_columns(self) -> bool:
        """Whether actions have the state's columns, as far as names and numbers say."""
        return len(self.action_names) == len(self.names) and (
            list(self.action_names) == list(self.names) or not set(self.action_names) & set(self.names)
        )


def spread(total: int, most: int) -> list[int]:
    """At most so many of `range(total)`, far apart."""
    return sorted({round(i) for i in np.linspace(0, total - 1, most)})
