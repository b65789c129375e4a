"""How faithfully an aligned episode follows its source: a few measures of it as shares of 1, of which the worst is the score.

This is a diagnosis of geometry. Whether the episode works in contact it does not tell: over committed replays its AUC is 0.34 to 0.62.
"""

from dataclasses import dataclass

import numpy as np

from cei_gym.alignment.judge.report import AlignmentReport

HALVES = {"residual": 20.0, "limits": 0.5, "jumps": 1.0, "clearance": 10.0, "reach": 0.05}
"""Where each part is 0.5. `residual`: mean distance between pads, mm; `limits`: share of frames in which a
joint of the arm sits at a limit; `jumps`: how far the fastest joint goes beyond its velocity limit, as a multiple of it;
`clearance`: deepest penetration, mm; `reach`: share of frames that are out of reach."""


@dataclass(frozen=True)
class Fidelity:
    """Fidelity of an aligned episode.

    A part is 1 / (1 + (x / h)^2) of what it measures, x, and where it shall be 0.5, h (`HALVES`): 1 for the best there could
    be, falling to 0. An episode follows as well as what is worst about it.

    Attributes:
        parts: in [0, 1], by the names of `HALVES`.
        frame: where the worst of them is worst.
    """

    parts: dict[str, float]
    frame: int

    @property
    def weakest(self) -> str:
        """Name of the worst part."""
        return min(self.parts, key=self.parts.__getitem__)

    @property
    def score(self) -> float:
        """The worst part, in [0, 1]."""
        return self.parts[self.weakest]


def assess(report: AlignmentReport) -> Fidelity:
    """The fidelity of an episode that has been diagnosed."""
    beyond = np.maximum(report.speed_share - 1.0, 0.0)
    unreachable = report.pad_distance_mm > report.unreachable_mm
    # what is measured, and how bad each frame is in that respect
    measured = {
        "residual": (report.pad_distance_mm.mean(), report.pad_distance_mm),
        "limits": (report.arm_at_limit.mean(), report.arm_at_limit),
        "jumps": (beyond.max(), beyond),
        "clearance": (report.penetration_mm.max(), report.penetration_mm),
        "reach": (unreachable.mean(), report.pad_distance_mm),
    }
    parts = {name: float(1.0 / (1.0 + (measured[name][0] / half) ** 2)) for name, half in HALVES.items()}
    weakest = min(parts, key=parts.__getitem__)
    return Fidelity(parts, int(np.argmax(measured[weakest][1])))
