"""What is finished of the real-world table, and how much of it succeeds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from cei_converters.benchmark import paper
from cei_converters.benchmark.cells import Cell
from cei_converters.benchmark.policy_stages import PolicyCell
from cei_converters.benchmark.real_tasks import TASKS, RealTask
from cei_converters.replay import wilson


@dataclass(frozen=True)
class Rate:
    """How many of how many succeed."""

    successes: int
    of: int

    def __str__(self) -> str:
        return f"{self.successes} of {self.of}"

    @property
    def share(self) -> float:
        """From 0 to 1."""
        return self.successes / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """In which the share lies with 95 % confidence (Wilson)."""
        return wilson(self.successes, self.of)


type Pair = tuple[Rate | None, Rate | None]
"""On the target, and of the source itself; None where nothing is finished."""


@dataclass(frozen=True)
class Found:
    """Finished cells: the contents of their JSONs."""

    replays: Mapping[Cell, Mapping[str, Any]]
    policies: Mapping[PolicyCell, Mapping[str, Any]]

    @property
    def tasks(self) -> list[RealTask]:
        """Those of which something is finished."""
        names = {cell.task for cell in (*self.replays, *self.policies)}
        return [task for name, task in TASKS.items() if name in names]

    @property
    def commits(self) -> list[str]:
        """At which they were measured, each once."""
        return sorted({str(result["commit"]) for result in (*self.replays.values(), *self.policies.values())})

    def replayed(self, task: RealTask) -> Pair:
        """A task's demonstrations."""
        return of_replay(self.replays.get(task.replayed)), of_replay(self.replays.get(task.recorded))

    def learnt(self, task: RealTask) -> Pair:
        """A task's policies."""
        return of_policy(self.policies.get(task.policy)), of_policy(self.policies.get(task.own_policy))


def of_paper(task: RealTask) -> Pair:
    """The paper's policies."""
    if task.figures is None:
        return None, None
    target, own = (Rate(successes, paper.REAL_TRIALS) for successes in task.figures)
    return target, own


def of_replay(result: Mapping[str, Any] | None) -> Rate | None:
    """A cell of replay's."""
    return None if result is None else Rate(result["replay"]["successes"], result["replay"]["episodes"])


def of_policy(result: Mapping[str, Any] | None) -> Rate | None:
    """A policy's."""
    return None if result is None else Rate(sum(result["successes"]), len(result["successes"]))


def failures_of(result: Mapping[str, Any] | None) -> str:
    """Why replays of a cell failed, and how many each."""
    failures: dict[str, int] = {} if result is None else result["replay"]["failures"]
    return ", ".join(f"{reason}: {count}" for reason, count in failures.items())
