"""Some episodes of a dataset, on which what is chosen for all of them alike is tried."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cei_converters.conversion.trials import Trials
from cei_gym.demonstration import Demonstration
from cei_gym.transfer import Transfer

if TYPE_CHECKING:
    from cei_converters.simulation.stage import Stage

BETTER = 0.1
"""A share of replays by which what is chosen holds better; less may be luck."""


@dataclass(frozen=True)
class Sample:
    """Episodes, and where they are tried.

    Attributes:
        transfer: fitted.
        stage: the target's environment.
        demonstrations: of the source, spread over the dataset.
        allow_unreachable: whether what is out of reach somewhere is replayed.
    """

    transfer: Transfer
    stage: "Stage"
    demonstrations: Sequence[Demonstration]
    allow_unreachable: bool = False

    def trials(self) -> Trials:
        """Each is replayed as it is, and perturbed once."""
        return Trials(self.stage, 1, self.allow_unreachable)
