"""The quality gate: which converted episodes are left out, as they are not likely enough to work, and which are marked."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cei_gym.errors import CEIError

KEPT, FLAGGED, DROPPED = "kept", "flagged", "dropped"
LOW_QUALITY = "of low quality"
"""Why a dropped episode is left out: it is not known to be likely enough to work."""
ANOTHER_WAY = "goes another way"
"""Why an episode is left out that would teach a policy something else than the others do."""
FAILS_IN_TWIN = "fails in its twin"
"""Why an episode is left out that a twin of its recording shows to fail."""

_SHOWN = 10


@dataclass(frozen=True)
class Gate:
    """Bounds on an episode's quality, the probability that it works, each in [0, 1] or None. What nothing is known of is below any.

    Attributes:
        min_quality: what is below is left out.
        flag: what is below, and not left out, is marked.

    Raises:
        CEIError: a bound is no score, or nothing could be marked.
    """

    min_quality: float | None = None
    flag: float | None = None

    def __post_init__(self) -> None:
        for name, bound in self.bounds.items():
            if not 0 <= bound <= 1:
                raise CEIError(f"--{name}={bound:g}: qualities are from 0 to 1.")
        if self.min_quality is not None and self.flag is not None and self.flag <= self.min_quality:
            raise CEIError(
                f"--flag={self.flag:g} marks nothing that --min_quality={self.min_quality:g} keeps; give it a higher value."
            )

    @property
    def bounds(self) -> dict[str, float]:
        """The bounds that are given, by the name of their option."""
        return {name: bound for name, bound in vars(self).items() if bound is not None}

    def decision(self, probability: float | None) -> str:
        """What becomes of an episode that works with a probability, None if that is not known: KEPT, FLAGGED or DROPPED."""
        likely = -1.0 if probability is None else probability
        if self.min_quality is not None and likely < self.min_quality:
            return DROPPED
        return FLAGGED if self.flag is not None and likely < self.flag else KEPT

    def judge(self, entries: Sequence[dict[str, Any]]) -> dict[str, list[int]]:
        """The result of a gated conversion: which episodes are `dropped` and which `flagged`.

        Args:
            entries: per episode `episode` and its `quality`, a probability or None.

        Raises:
            CEIError: all are dropped.
        """
        decisions = [(entry["episode"], self.decision(entry["quality"])) for entry in entries]
        found = {
            decision: [episode for episode, its in decisions if its == decision] for decision in (DROPPED, FLAGGED)
        }
        if entries and len(found[DROPPED]) == len(entries):
            known = [entry["quality"] for entry in entries if entry["quality"] is not None]
            best = f"the best has {max(known):.2f}" if known else "nothing is known of any"
            raise CEIError(
                f"no episode of {len(entries)} reaches --min_quality={self.min_quality:g} ({best}), so all are dropped and nothing is written; lower it."
            )
        return found


def in_words(judged: dict[str, list[int]]) -> str:
    """`Gate.judge` in one line."""
    return ", ".join(f"{decision} {_listed(episodes)}" for decision, episodes in judged.items())


def _listed(episodes: Sequence[int]) -> str:
    if not episodes:
        return "0"
    more = ", ..." if len(episodes) > _SHOWN else ""
    return f"{len(episodes)} (episode {', '.join(map(str, episodes[:_SHOWN]))}{more})"
