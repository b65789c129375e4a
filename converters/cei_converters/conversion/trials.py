"""How well a transferred demonstration holds in physics: once as it is, and slightly otherwise."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cei_gym.demonstration import Demonstration

if TYPE_CHECKING:
    from cei_converters.simulation.stage import Stage
    from cei_gym.alignment import AlignmentReport

# Numbers of perturbations. Those that reports have (`cei-replay --perturb`) begin at 0: nothing is chosen by them.
_JUDGED, _CONFIRMED = 1000, 2000


@dataclass(frozen=True)
class Held:
    """What replays showed.

    Attributes:
        failure: why it fails as it is; empty if it does not.
        perturbed: whether each perturbed replay succeeded; empty if it fails as it is, or none was asked for.
    """

    failure: str
    perturbed: Sequence[bool] = ()

    @property
    def share(self) -> float:
        """Of all replays, the plain one and the perturbed, those that succeed; 0 if the plain one fails."""
        return 0.0 if self.failure else (1 + sum(self.perturbed)) / (1 + len(self.perturbed))


class Trials:
    """Replays of one target's demonstrations.

    Args:
        stage: its environment.
        perturbed: how many perturbed replays judge one.
        allow_unreachable: replay also what is out of reach somewhere; else that fails without.

    Attributes:
        replays: how many there have been.
    """

    def __init__(self, stage: "Stage", perturbed: int = 0, allow_unreachable: bool = False) -> None:
        self._stage, self._perturbed, self._allow_unreachable = stage, perturbed, allow_unreachable
        self.replays = 0

    def judge(self, moved: Demonstration, report: "AlignmentReport") -> Held:
        """Replay one as it is and, if it succeeds, perturbed."""
        if report.unreachable_frames and not self._allow_unreachable:
            return Held("unreachable")
        self.replays += 1
        result, _ = self._stage.play(_stored(moved))
        if not result["success"]:
            return Held(result["failure"])
        return Held("", self._slightly_otherwise(moved, _JUDGED))

    def confirm(self, moved: Demonstration) -> float:
        """Share of as many other perturbed replays that succeed: what was chosen for its luck shows; 1 where there are none."""
        held = self._slightly_otherwise(moved, _CONFIRMED)
        return sum(held) / len(held) if held else 1.0

    def _slightly_otherwise(self, moved: Demonstration, first: int) -> list[bool]:
        from cei_converters.simulation.perturbation import Perturbation

        held: list[bool] = []
        for which in range(first, first + self._perturbed):
            perturbation = Perturbation.draw(moved.index, which, self._stage.n_arm)
            self.replays += 1
            held.append(bool(self._stage.play(_stored(moved), perturbation=perturbation)[0]["success"]))
        return held


def _stored(moved: Demonstration) -> Demonstration:
    """With the very start that a replay of the dataset has."""
    return replace(moved, qpos=moved.qpos.astype(np.float32).astype(float))
