"""How demonstrations are transferred."""

from dataclasses import dataclass

import numpy as np

from cei_gym.errors import CEIError, unknown
from cei_gym.functional import VARIANTS

METHODS = ("cei", "bms")
"""The paper's method, and its baseline."""

_MOST_POINTS = 100_000


@dataclass(frozen=True)
class TransferOptions:
    """Options of a transfer.

    Attributes:
        method: "cei", or "bms" (the paper's baseline, binary manual specification: see `ManualAlignment`).
        representation: which points stand for a pad: "standard", or "reduced" or "dropped" (the paper's sensitivity
            analysis).
        points: point-normal pairs of each functional representation.
        seed: of sampling pads.
        stretch: how many times as long an episode may become where the target is too slow to keep up: the source then waits
            for it, frame by frame. 1 keeps the frames as they are.
        unreachable_mm: mean pad distance above which a frame counts as out of the target's reach.
    """

    method: str = "cei"
    representation: str = "standard"
    points: int = 64
    seed: int = 0
    stretch: float = 2.0
    unreachable_mm: float = 30.0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise unknown("transfer.method", self.method, METHODS)
        if self.representation not in VARIANTS:
            raise unknown("transfer.representation", self.representation, VARIANTS)
        if not 1 <= self.stretch < np.inf:
            raise CEIError(f"transfer.stretch={self.stretch} must be at least 1.")
        if not 1 <= self.points <= _MOST_POINTS:
            raise CEIError(f"transfer.points={self.points} must be at least 1, and at most {_MOST_POINTS}.")
        if self.seed < 0:
            raise CEIError(f"transfer.seed={self.seed} must be at least 0.")
        if not 0 < self.unreachable_mm < np.inf:
            raise CEIError(f"transfer.unreachable_mm={self.unreachable_mm} must be positive.")
