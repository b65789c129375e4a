"""From which start all episodes of a dataset follow, by rollouts: starts that follow as well may hold nothing, or everything."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cei_converters.conversion.refine import RefineOptions
from cei_converters.conversion.sample import BETTER, Sample
from cei_converters.conversion.trials import Trials
from cei_gym.demonstration import Demonstration
from cei_gym.transfer import Attempt

_HOPELESS = 3  # episodes that fail in a row from the first: of starts that are worth having one in a hundred does so


@dataclass(frozen=True)
class Chosen:
    """A start that holds better than the one that follows best.

    Attributes:
        start: which of the finalists of `Transfer.fit`, best first.
        held: share of the replays that chose it, the plain and the perturbed of some episodes, that succeed.
        best_held: the same of the one that follows best.
        tried: how many starts were, until one was robust.
    """

    start: int
    held: float
    best_held: float
    tried: int

    def __str__(self) -> str:
        return (
            f"start {self.start + 1}, of {self.tried} that were tried, of which {self.held:.0%} of some replays hold, and {self.best_held:.0%} "
            "of the one that follows best"
        )


def choose_start(sample: Sample, options: RefineOptions, done: Callable[[int], None] = lambda _: None) -> Chosen | None:
    """Try starts on some episodes; those that cannot do better any more are given up.

    Args:
        sample: the episodes.
        options: of refinement.
        done: called with how many starts more are done, of `options.starts`.

    Returns:
        None where episodes hold well enough from the start that follows best, or no other holds clearly better. Of several modes each has its own
        start, and none is chosen.
    """
    transfer, trials = sample.transfer, sample.trials()
    tried = min(options.starts, len(transfer.finalists))
    if tried < 2 or len(transfer.basins) != 1 or not sample.demonstrations:
        return None
    by_start = [_held(sample, trials, 0)]
    done(1)
    if by_start[0] >= options.robust:
        return None
    for start in range(1, tried):
        by_start.append(_held(sample, trials, start, max(by_start)))
        done(1)
        if by_start[-1] >= options.robust:
            break
    chosen = int(np.argmax(by_start))
    if by_start[chosen] < by_start[0] + BETTER:
        return None
    confirmed = [_confirmed(sample, trials, start) for start in (chosen, 0)]
    return (
        Chosen(chosen, by_start[chosen], by_start[0], len(by_start)) if confirmed[0] >= confirmed[1] + BETTER else None
    )


def _held(sample: Sample, trials: Trials, start: int, least: float | None = None) -> float:
    """Share of replays that hold from a start, in the mean over episodes. With `least`, 0 as soon as it cannot be over that, or seems hopeless."""
    held, n = 0.0, len(sample.demonstrations)
    for i, demonstration in enumerate(sample.demonstrations):
        held += trials.judge(*_moved(sample, demonstration, start)).share
        if least is not None and i < n - 1 and (held + n - 1 - i <= least * n or (not held and i + 1 == _HOPELESS)):
            return 0.0
    return held / n


def _confirmed(sample: Sample, trials: Trials, start: int) -> float:
    """The same of others, that nothing was chosen by."""
    return float(np.mean([trials.confirm(_moved(sample, each, start)[0]) for each in sample.demonstrations]))


def _moved(sample: Sample, demonstration: Demonstration, start: int):
    aligned = sample.transfer.aligned(demonstration, attempt=Attempt(basin=start or None))
    return sample.transfer.made(aligned, clouds=False)
