"""How long the steps of demonstrations took, where that need not be what the frames a second say: a simulation's steps wait for joints."""

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import draccus
import numpy as np
from draccus.utils import DraccusException

from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line

STEP_TIMES = "step_times_s"
"""Field of an episode's record: `StepTimes`."""
_LONGER = 1.01


@dataclass(frozen=True)
class StepTimes:
    """Of an episode.

    Attributes:
        robot: whose steps were timed; those of a converted episode are its source's.
        each: a frame's step, s.
        at_most: longest that one could have waited, s; None where that is not known.
    """

    robot: str
    each: Sequence[float]
    at_most: float | None = None

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Self | None:
        """What an episode's record, which may be a stranger's, says; None if nothing, or nothing that can be."""
        raw = record.get(STEP_TIMES)
        if not isinstance(raw, dict) or raw.keys() != {"robot", "each", "at_most"} or not isinstance(raw["robot"], str):
            return None
        each, at_most = raw["each"], raw["at_most"]
        if not isinstance(each, list) or not each or not all(map(_is_time, each)):
            return None
        return cls(raw["robot"], each, at_most) if at_most is None or _is_time(at_most) else None

    def at(self, frames: Array) -> Self | None:
        """Those of these frames, in their order; None if there are no such frames."""
        if frames.min() < 0 or frames.max() >= len(self.each):
            return None
        return type(self)(self.robot, [self.each[frame] for frame in frames], self.at_most)

    def record(self) -> dict[str, Any]:
        """As a field of a record."""
        return {STEP_TIMES: asdict(self)}


@dataclass(frozen=True)
class StepTime:
    """Of a dataset, over all steps that were timed.

    Attributes:
        robots: whose steps were timed.
        steps: how many.
        in_time: share of them that took no longer than a period of the dataset's frames a second.
        mean, median, p95, max: of what they took, s.
        at_most: longest that one could have waited, s; None where that is not known.
    """

    robots: tuple[str, ...]
    steps: int
    in_time: float
    mean: float
    median: float
    p95: float
    max: float
    at_most: float | None = None

    @classmethod
    def of(cls, records: Iterable[Mapping[str, Any]], fps: float) -> Self | None:
        """From the records of a dataset's episodes; None if none was timed.

        Args:
            records: of episodes.
            fps: frames a second of the dataset.
        """
        robots, longest, seconds = dict[str, None](), list[float | None](), array("d")
        for times in filter(None, map(StepTimes.of, records)):
            robots[times.robot] = None
            longest.append(times.at_most)
            seconds.extend(times.each)
        if not seconds:
            return None
        each = np.asarray(seconds)
        median, p95 = np.quantile(each, (0.5, 0.95), method="higher").tolist()  # times that a step did take
        known = [each for each in longest if each is not None]
        return cls(
            robots=tuple(robots),
            steps=len(each),
            in_time=float(np.mean(each < _LONGER / fps)),
            mean=round(float(each.mean()), 6),
            median=median,
            p95=p95,
            max=float(each.max()),
            at_most=max(known) if len(known) == len(longest) else None,
        )

    @classmethod
    def decode(cls, raw: object, where: str) -> Self:
        """From JSON types, which may be a stranger's.

        Raises:
            CEIError: a figure is missing, or none that can be.
        """
        if not isinstance(raw, dict):
            raise CEIError(f"{where}: step_time_s should be a JSON object, not {one_line(raw, 60)}.")
        try:
            found = draccus.decode(cls, raw)
        except (DraccusException, TypeError) as error:
            raise CEIError(f"{where}: step_time_s: {one_line(error)}.") from error
        found.check(where)
        return found

    @property
    def waits(self) -> bool:
        """Whether some step took longer than a period."""
        return self.in_time < 1

    def check(self, where: str) -> None:
        """Check what a stranger may have said.

        Raises:
            CEIError: a figure is none that can be.
        """
        seconds = [self.mean, self.median, self.p95, self.max, *([] if self.at_most is None else [self.at_most])]
        if not all(map(_is_time, [*seconds, self.steps])) or not _is_number(self.in_time) or not 0 <= self.in_time <= 1:
            raise CEIError(
                f"{where}: step_time_s should be times above 0, s, and a share in_time, not {one_line(asdict(self), 200)}."
            )
        if not isinstance(self.robots, tuple) or not all(isinstance(robot, str) for robot in self.robots):
            raise CEIError(f"{where}: step_time_s.robots should be names, not {one_line(self.robots, 60)}.")

    def sentence(self, fps: float) -> str:
        """In plain words.

        Args:
            fps: frames a second of the dataset.
        """
        whose = f"a step of {' or '.join(self.robots)}"
        if not self.waits:
            return f"In simulation {whose} took {1 / fps:.3g} s, as {fps:g} frames a second say."
        return (
            f"Frames are said to be {1 / fps:.3g} s apart ({fps:g} a second); in simulation {whose} took that in {100 * self.in_time:.0f} %, "
            f"{self.mean:.3g} s in the mean, and where it waited for its joints up to {self.max:.3g} s."
        )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_time(value: Any) -> bool:
    return _is_number(value) and value > 0
