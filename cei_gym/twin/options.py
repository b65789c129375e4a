"""Options of the twin of a recording."""

from dataclasses import dataclass
from math import inf

from cei_gym.errors import CEIError


@dataclass(frozen=True)
class TwinOptions:
    """What is assumed of what nobody measured, and how many tries an answer takes.

    Attributes:
        density_kg_m3: of what is held, hollow or not.
        friction: of what is held; tries differ in it by a fifth each way.
        tries: of the target, each with another shape, start and friction.
        shift_m: how far what is held is moved in a try.
        sure: share of tries that have to agree; less is `unsure`. All, as a wrong answer is worse than none.
        seed: of what is drawn.

    Raises:
        CEIError: a figure that cannot be.
    """

    density_kg_m3: float = 400.0
    friction: float = 0.8
    tries: int = 6
    shift_m: float = 0.0025
    sure: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("density_kg_m3", "friction"):
            if not 0 < getattr(self, name) < inf:
                raise CEIError(f"twin.{name}={getattr(self, name)} must be a finite number over 0.")
        if self.tries < 1:
            raise CEIError(f"twin.tries={self.tries} must be at least 1.")
        if not 0 <= self.shift_m < inf:
            raise CEIError(f"twin.shift_m={self.shift_m} must be a finite number, at least 0.")
        if not 0.5 < self.sure <= 1:
            raise CEIError(f"twin.sure={self.sure} must be over 0.5, and at most 1.")
