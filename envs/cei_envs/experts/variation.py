"""How one demonstration of an expert differs from the next, as people's do."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Variation:
    """How one demonstration differs from the ideal one. Figures are for people, whose variation is 1.

    Attributes:
        offset_m: (3,) error of the grasp point; up to 6 mm each way.
        yaw_rad: turn of the grasp about the vertical, up to 0.12.
        tilt_rad: (2,) lean of the approach about world x and y, up to 0.12.
        speed: 0.7 to 1.4.
        jitter_m: tremor of the hand.
    """

    offset_m: tuple[float, float, float]
    yaw_rad: float
    tilt_rad: tuple[float, float]
    speed: float
    jitter_m: float

    @classmethod
    def sample(cls, rng: np.random.Generator, amount: float = 1.0) -> "Variation":
        """Draw a variation; 0 is the ideal demonstration."""
        x, y, z = amount * rng.uniform(-0.006, 0.006, 3)
        tilt = amount * rng.uniform(-0.12, 0.12, 2)
        return cls(
            (float(x), float(y), float(z)),
            float(amount * rng.uniform(-0.12, 0.12)),
            (float(tilt[0]), float(tilt[1])),
            float(rng.uniform(0.7, 1.4) ** amount),
            float(amount * rng.uniform(0.0005, 0.0015)),
        )

    def frames(self, n: int) -> int:
        """How many frames a movement of n ideal frames takes at this speed."""
        return max(4, round(n / self.speed))
