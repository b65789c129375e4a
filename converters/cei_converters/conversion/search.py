"""What to try next where a way of transferring an episode does not hold: what a list says, or what CMA-ES draws."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from cei_gym.alignment.contact.correction import Correction
from cei_gym.arrays import Array
from cei_gym.transfer import Attempt

SIGMA = Correction(0.005, 0.005, 0.005, 0.08, 0.08, 0.12, 0.2, 0.15, 0.1, 0.004, 0.1)
"""How far each figure of a correction is drawn from what it is plainly, a standard deviation."""
_SQUEEZE, _ASYMMETRY = (0.3, 3.0), 0.6


class Search(Protocol):
    """Says what to try next, and is told what came of it."""

    def ask(self) -> Attempt | None:
        """What to try next; None if there is nothing left."""
        ...

    def tell(self, share: float) -> None:
        """Which share of replays of what was asked last held."""
        ...


class Listed:
    """What a list says, in its order."""

    def __init__(self, attempts: Sequence[Attempt]) -> None:
        self._left = list(attempts)

    def ask(self) -> Attempt | None:
        return self._left.pop(0) if self._left else None

    def tell(self, share: float) -> None:
        pass


class Sampled:
    """Corrections drawn by CMA-ES, each generation around what held of the last; without an end.

    Args:
        seed: of what is drawn; the same gives the same.
        population: of a generation.
        around: the correction to begin with.
    """

    def __init__(self, seed: Sequence[int], population: int, around: Correction | None = None) -> None:
        from cmaes import CMA  # a fifth of a second

        drawn = np.random.SeedSequence(seed).generate_state(1)[0]
        self._cma = CMA(_normal(around or Correction()), 1.0, seed=int(drawn), population_size=population)
        self._told: list[tuple[Array, float]] = []
        self._asked = np.zeros(0)

    def ask(self) -> Attempt:
        self._asked = self._cma.ask()
        return Attempt(correction=_correction(self._asked))

    def tell(self, share: float) -> None:
        self._told.append((self._asked, -share))
        if len(self._told) == self._cma.population_size:
            self._cma.tell(self._told)
            self._told = []


class InTurn:
    """One search after another has nothing left."""

    def __init__(self, searches: Sequence[Search]) -> None:
        self._left = list(searches)

    def ask(self) -> Attempt | None:
        while self._left:
            if (attempt := self._left[0].ask()) is not None:
                return attempt
            self._left.pop(0)
        return None

    def tell(self, share: float) -> None:
        self._left[0].tell(share)


def _normal(correction: Correction) -> Array:
    """(11,) a correction's figures in standard deviations from what is plain."""
    plain, sigma = (np.array(list(vars(each).values())) for each in (Correction(), SIGMA))
    return (np.array(list(vars(correction).values())) - plain) / sigma


def _correction(drawn: Array) -> Correction:
    """What was drawn, within what a correction can be."""
    plain, sigma = (np.array(list(vars(each).values())) for each in (Correction(), SIGMA))
    figures = dict(zip(Correction.names(), (plain + sigma * drawn).tolist(), strict=True))
    figures["squeeze"] = float(np.clip(figures["squeeze"], *_SQUEEZE))
    figures["asymmetry"] = float(np.clip(figures["asymmetry"], -_ASYMMETRY, _ASYMMETRY))
    for name in ("wider_m", "dwell_s"):
        figures[name] = max(0.0, figures[name])
    return Correction(**figures)
