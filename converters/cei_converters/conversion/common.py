"""A correction for all episodes of a dataset, where they fail alike: one chosen on a single episode may harm the others."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cei_converters.conversion.refine import RefineOptions
from cei_converters.conversion.sample import BETTER, Sample
from cei_converters.conversion.search import Sampled
from cei_converters.conversion.trials import Trials
from cei_gym.alignment.contact.correction import Correction
from cei_gym.transfer import Attempt, Transfer

if TYPE_CHECKING:
    from cei_gym.transfer.aligned import Aligned


def common_correction(
    sample: Sample, options: RefineOptions, done: Callable[[int], None] = lambda _: None
) -> Correction | None:
    """Search one by rollouts of some episodes.

    Args:
        sample: the episodes.
        options: of refinement.
        done: called with how many generations more are done, of `options.generations`.

    Returns:
        None where episodes hold well enough as they are, or nothing holds clearly better.
    """
    aligned = [sample.transfer.aligned(demonstration) for demonstration in sample.demonstrations]
    aligned = [each for each in aligned if each.holds]
    if not aligned or not options.generations:
        return None
    judged = _Judged(sample.transfer, sample.trials(), aligned)
    plain = judged.share(None)
    if plain >= options.robust:
        return None
    search, found = Sampled((options.seed, len(aligned)), options.population), dict[Correction, float]()
    for _ in range(options.generations):
        for _ in range(options.population):
            correction = search.ask().correction
            assert correction is not None
            found[correction] = judged.share(correction)
            search.tell(found[correction])
        done(1)
        if max(found.values()) == 1:
            break
    best = max(found, key=lambda each: found[each])
    if found[best] < plain + BETTER:
        return None
    return best if judged.confirmed(best) >= judged.confirmed(None) + BETTER else None


class _Judged:
    """How well corrections do on all of some episodes."""

    def __init__(self, transfer: Transfer, trials: Trials, aligned: "Sequence[Aligned]") -> None:
        self._transfer, self._trials, self._aligned = transfer, trials, aligned

    def share(self, correction: Correction | None) -> float:
        """Of replays that hold, in the mean over episodes."""
        return float(np.mean([self._trials.judge(*self._made(each, correction)).share for each in self._aligned]))

    def confirmed(self, correction: Correction | None) -> float:
        """The same of others, that nothing was chosen by."""
        return float(np.mean([self._trials.confirm(self._made(each, correction)[0]) for each in self._aligned]))

    def _made(self, aligned: "Aligned", correction: Correction | None):
        return self._transfer.made(aligned, Attempt(correction=correction), clouds=False)
