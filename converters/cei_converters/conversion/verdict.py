"""What replaying an episode showed, and many of them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from cei_converters.dataset import corrections
from cei_converters.dataset.corrections import Corrected
from cei_gym.alignment.contact.correction import Correction
from cei_gym.errors import CEIError

CORRECTED = "corrected"
"""How ways begin that have a correction."""


@dataclass(frozen=True)
class Verdict:
    """What replaying an episode showed.

    Attributes:
        episode: its index in the source's dataset.
        success: whether some way of converting it succeeds.
        attempts: how many were tried.
        how: the one that is kept (`cei_gym.transfer.Attempt`).
        failure: why the plain one fails; empty if it does not.
        dropped: whether the episode is left out.
        held, plain_held: with refinement, which share of replays succeeded of the way that is kept, and of the plain one; these chose it, so
            fresh ones (`cei-replay --perturb`) may show less.
        replays: how many there were.
        judged: how many replays of the way that is kept its share is of.
        corrected: the correction that is kept, if one is.
    """

    episode: int
    success: bool
    attempts: int
    how: str
    failure: str
    dropped: bool = False
    held: float | None = None
    plain_held: float | None = None
    replays: int | None = None
    judged: int = 1
    corrected: Corrected | None = None

    @property
    def share(self) -> float:
        """Which share of replays succeeds of the way that is kept."""
        return float(self.success) if self.held is None else self.held

    @classmethod
    def decode(cls, stored: dict[str, Any]) -> Self:
        """What `dataclasses.asdict` made of one.

        Raises:
            KeyError, TypeError: it is something else.
        """
        built: dict[str, Any] = {}
        if (found := stored.get(corrections.CORRECTED)) is not None:
            built[corrections.CORRECTED] = Corrected(**found | {"correction": Correction(**found["correction"])})
        return cls(**stored | built)

    def record(self) -> dict[str, Any]:
        """For the dataset's metadata."""
        names = ["success", "attempts", "how", "failure"]
        names += [name for name in ("held", "plain_held", "replays") if getattr(self, name) is not None]
        found = {name: getattr(self, name) for name in names}
        return found if self.corrected is None else found | {corrections.CORRECTED: self.corrected.record()}

    def row(self) -> dict[str, str]:
        """For the table on the terminal."""
        kept = self.how if self.success else "failed"
        return {"plain": self.failure or "success", "verified": "dropped" if self.dropped else kept}


def summarise(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """The result of a verified conversion, apart from that of the plain one."""
    return {
        "episodes": len(verdicts),
        "plain_successes": sum(not v.failure for v in verdicts),
        "verified_successes": sum(v.success for v in verdicts),
        "retried": sum(v.attempts > 1 for v in verdicts),
        "dropped": [v.episode for v in verdicts if v.dropped],
        "how": dict(Counter(_kind(v.how) for v in verdicts if v.success)),
        **_shares(verdicts),
        "results": [{"episode": v.episode, **v.record()} for v in verdicts],
    }


def _kind(how: str) -> str:
    """Corrections are each their own; they count as one kind."""
    return CORRECTED if how.startswith(CORRECTED) else how


def _shares(verdicts: Sequence[Verdict]) -> dict[str, float]:
    """Which share of replays holds in the mean, plain and kept, where episodes are refined."""
    refined = [v for v in verdicts if v.held is not None]
    if not refined:
        return {}
    names = ("plain_held", "held")
    return {name: float(np.mean([getattr(v, name) for v in refined])) for name in names} | {
        "replays": sum(v.replays or 0 for v in refined)
    }


def sentence(summary: dict[str, Any]) -> str:
    """`summarise` in one line."""
    n = summary["episodes"]
    text = (
        f"plain {summary['plain_successes']}/{n}, verified {summary['verified_successes']}/{n} "
        f"({summary['retried']} retried), dropped {len(summary['dropped'])}"
    )
    if "held" not in summary:
        return text
    return f"{text}; of replays held {summary['plain_held']:.0%} plain, {summary['held']:.0%} refined ({summary['replays']} replays)"


def check_kept(summary: dict[str, Any]) -> None:
    """Check that an episode is left.

    Raises:
        CEIError: all are dropped.
    """
    n = len(summary["dropped"])
    if n == summary["episodes"]:
        raise CEIError(
            f"no episode of {n} succeeds, so all are dropped and nothing is written; leave out --verify.drop."
        )
