"""What a twin says of an episode."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

HOLDS, FAILS, UNSURE, CANNOT = "holds", "fails", "unsure", "cannot be judged"


@dataclass(frozen=True)
class Evidence:
    """An answer, and what it rests on.

    Attributes:
        answer: "holds", "fails", "unsure", or "cannot be judged".
        votes: of each try of the target, whether it held.
        shapes: what what is held was taken for, those in which the source's own motion held.
        reason: why it cannot be judged; else empty.
    """

    answer: str
    votes: tuple[bool, ...] = ()
    shapes: tuple[str, ...] = ()
    reason: str = ""

    @classmethod
    def none(cls, reason: str) -> "Evidence":
        """It cannot be judged, and why."""
        return cls(CANNOT, reason=reason)

    @classmethod
    def of(cls, votes: Sequence[bool], shapes: Sequence[str], sure: float) -> "Evidence":
        """By tries, of which so large a share has to agree."""
        share = sum(votes) / len(votes)
        answer = HOLDS if share >= sure else FAILS if 1 - share >= sure else UNSURE
        return cls(answer, tuple(votes), tuple(shapes))

    @staticmethod
    def lost(votes: Sequence[bool], tries: int, sure: float) -> bool:
        """Whether tries, of so many in all, cannot agree any more, whatever the rest say."""
        left = tries - len(votes)
        return max(sum(votes), len(votes) - sum(votes)) + left < sure * tries

    def record(self) -> dict[str, Any]:
        """As JSON types."""
        if self.reason:
            return {"answer": self.answer, "reason": self.reason}
        return {
            "answer": self.answer,
            "held": sum(self.votes),
            "tries": len(self.votes),
            "shapes": list(self.shapes),
        }
