"""An episode's quality: how likely it works, by replays in its environment or by the twin of its recording; else it is not known."""

from dataclasses import dataclass
from typing import Any, Self

from cei_converters.conversion.verdict import Verdict
from cei_gym.twin.calibration import probability
from cei_gym.twin.evidence import Evidence

REPLAYS, TWIN = "replays", "twin"
"""What it is known by."""
PRIOR = (0.15, 0.05)
"""How many successes and failures are counted beside those of replays, so that few never make sure: of the beta distribution that explains best how
often each episode of `results/twin` succeeds in four replays (`benchmarks/score.py`). One success gives 0.96, one failure 0.12, four of five 0.80."""


@dataclass(frozen=True)
class Quality:
    """How likely an episode works: succeeds when it is replayed from a start a little otherwise.

    Attributes:
        probability: in [0, 1]; None where nothing tells.
        by: what it is known by, "replays" or "twin"; empty where nothing tells.
    """

    probability: float | None = None
    by: str = ""

    @classmethod
    def of(cls, verdict: Verdict | None, evidence: Evidence | None) -> Self:
        """By what replays showed, else by what a twin says, else unknown."""
        if verdict is not None:
            works, fails = PRIOR
            held, n = verdict.share, verdict.judged
            return cls((held * n + works) / (n + works + fails), REPLAYS)
        if evidence is not None and (likely := probability(evidence)) is not None:
            return cls(likely, TWIN)
        return cls()

    def record(self) -> dict[str, Any]:
        """As JSON types; nothing where nothing is known."""
        return {} if self.probability is None else {"probability": self.probability, "by": self.by}
