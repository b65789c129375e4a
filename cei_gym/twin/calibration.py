"""What an answer of a twin is worth: how likely an episode works of which it says so.

Counted, not assumed: of the episodes of `results/twin`, which were also replayed in their true environment, how many work of each answer
(`benchmarks/score.py`, which also tries it on objects and robots that were left out of the count).
"""

from collections.abc import Mapping

from cei_gym.twin.evidence import CANNOT, FAILS, HOLDS, UNSURE, Evidence

WORKED: Mapping[str, tuple[int, int]] = {HOLDS: (115, 117), UNSURE: (27, 38), FAILS: (2, 13)}
"""Per answer how many episodes work, and of how many."""


def probability(evidence: Evidence, worked: Mapping[str, tuple[int, int]] = WORKED) -> float | None:
    """The probability that an episode works, by what its twin says; None where that cannot judge.

    Args:
        evidence: of its twin.
        worked: counts to go by.

    Returns:
        (works + 1) / (of + 2), Laplace's rule, so that few counts never make sure.
    """
    if evidence.answer == CANNOT:
        return None
    works, of = worked[evidence.answer]
    return (works + 1) / (of + 2)
