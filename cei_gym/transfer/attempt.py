"""The ways of transferring a demonstration that a caller who can tell whether it worked may try in turn."""

from collections.abc import Sequence
from dataclasses import dataclass

from cei_gym.alignment.contact.correction import Correction

_OTHER_SQUEEZES = (0.5, 1.5)


@dataclass(frozen=True)
class Attempt:
    """One way of transferring a demonstration, for callers that can tell whether it worked; by default the plain one.

    Attributes:
        basin: which of the finalists of `Transfer.fit` to start from, best first; None for the mode's own.
        squeeze: factor on how far actions squeeze.
        representation: which points stand for a pad; None for those of the options.
        correction: of how it takes hold.
    """

    basin: int | None = None
    squeeze: float = 1.0
    representation: str | None = None
    correction: Correction | None = None

    @property
    def force(self) -> float:
        """Factor on how far actions squeeze, with the correction's."""
        return self.squeeze if self.correction is None else self.squeeze * self.correction.squeeze

    @property
    def asymmetry(self) -> float:
        """The correction's."""
        return 0.0 if self.correction is None else self.correction.asymmetry

    def __str__(self) -> str:
        if self.correction is not None:
            return f"corrected ({self.correction})"
        if self.basin is not None:
            return f"basin {self.basin + 1}"
        if self.representation is not None:
            return f"pads {self.representation}"
        return "plain" if self.squeeze == 1 else f"squeeze x{self.squeeze:g}"


def attempts(basins: Sequence[int], representation: str, most: int) -> list[Attempt]:
    """What to try in turn: plain; from other basins, best first; squeezing less and more; with other points on the pads.

    Where that is more than `most`, it is basins that are left out, so that each kind has its turn.

    Args:
        basins: which of the finalists are not the mode's own.
        representation: the points that are used by default.
        most: how many attempts.
    """
    pads = "standard" if representation == "reduced" else "reduced"
    rest = [*(Attempt(squeeze=factor) for factor in _OTHER_SQUEEZES), Attempt(representation=pads)]
    others = [Attempt(basin=i) for i in basins][: max(1, most - 1 - len(rest))]
    return [Attempt(), *others, *rest][:most]
