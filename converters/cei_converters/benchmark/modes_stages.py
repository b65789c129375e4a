"""Two motions from one demonstration: what each pattern is made with, and the stages of its policy."""

from dataclasses import dataclass
from typing import Any

from cei_converters.benchmark.policy_stages import PolicyCell, Stages
from cei_converters.benchmark.real_tasks import GRIPPER, HAND

TASK = "OpenDrawer"
TWO_MODES = ("--init=eis", "--init.modes=2")
"""Options of `cei-convert` that find both motions."""
PATTERNS = {"pattern_1": ("--init.mode=0",), "pattern_2": ("--init.mode=1",), "mixture": ()}
"""And those that take one of them, or each in turn."""


@dataclass(frozen=True)
class Pattern(PolicyCell):
    """The policy of a pattern, whose name is its variant."""

    task: str = TASK
    target: str = HAND
    variant: str = "mixture"
    source: str = GRIPPER

    @property
    def name(self) -> str:
        """The name of its files."""
        return f"modes_{self.variant}"

    @property
    def dataset(self) -> str:
        """Name of what it is trained on."""
        return f"{super().dataset}-{self.variant}"

    @property
    def sees_swapped(self) -> bool:
        """Whether it is evaluated on clouds as conversions make them: it is."""
        return True


class ModeStages(Stages):
    """The stages of patterns' policies."""

    def settings(self, cell: PolicyCell) -> dict[str, Any]:
        """What a finished pattern must have been made with to count."""
        return super().settings(cell) | {"options": [*TWO_MODES, *PATTERNS[cell.variant]]}

    def conversion(self, cell: PolicyCell) -> list[str]:
        """Options of `cei-convert` for a pattern."""
        return [*super().conversion(cell), *TWO_MODES, *PATTERNS[cell.variant]]
