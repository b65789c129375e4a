"""The paper's second half: tasks that go from a gripper to a hand, and back; which robot demonstrates which."""

from collections.abc import Iterable
from dataclasses import dataclass

from cei_converters.benchmark import paper
from cei_converters.benchmark.cells import Cell, listed
from cei_converters.benchmark.policy_stages import OWN, PolicyCell

GRIPPER, HAND = "UR5e-AG95", "UR5e-XHand"
"""The paper's robots, but for the arm: robosuite has a UR5e, no UR5."""


@dataclass(frozen=True)
class RealTask:
    """A task and the direction it goes.

    Attributes:
        name: of the task.
        source: whose demonstrations there are.
        target: whom they are converted for.
    """

    name: str
    source: str
    target: str

    @property
    def direction(self) -> str:
        """From which end-effector to which."""
        return " to ".join(robot.partition("-")[2] for robot in (self.source, self.target))

    @property
    def figures(self) -> tuple[int, int] | None:
        """The paper's: trials of `paper.REAL_TRIALS` that succeed on the target, and of the source's own policy on the source."""
        return paper.REAL.get(self.name)

    @property
    def replayed(self) -> Cell:
        """Its demonstrations on the target."""
        return Cell(self.name, self.target)

    @property
    def recorded(self) -> Cell:
        """Its demonstrations on the source itself."""
        return Cell(self.name, self.source)

    @property
    def policy(self) -> PolicyCell:
        """The target's policy, of converted demonstrations."""
        return PolicyCell(self.name, self.target, "cei", source=self.source)

    @property
    def own_policy(self) -> PolicyCell:
        """The source's own, of its own demonstrations."""
        return PolicyCell(self.name, self.source, OWN, source=self.source)


TASKS = {
    **{name: RealTask(name, GRIPPER, HAND) for name in ("PushCube", "OpenDrawer", "PlaceBird")},
    **{name: RealTask(name, HAND, GRIPPER) for name in ("PickCup", "PackageBread", "InsertFlower")},
    "PressButton": RealTask("PressButton", GRIPPER, HAND),
}
"""By name, in the paper's order. It has no figure of the last one, which it trains elsewhere (its section VII-A): that one is only replayed."""


def select_tasks(tasks: str | None) -> list[RealTask]:
    """Those of a list such as `a,b`; all where there is none.

    Raises:
        CEIError: there is no such task.
    """
    return [TASKS[name] for name in listed("task", tasks, TASKS)]


def transfer_ratio(rates: Iterable[tuple[float, float]]) -> float | None:
    """The paper's measure: mean success on targets, divided by that of the sources' own policies on the sources.

    Args:
        rates: for each task that of the target and that of the source.

    Returns:
        None of no task, and where no source succeeds.
    """
    targets, sources = map(sum, zip(*rates, strict=True)) if (rates := [*rates]) else (0.0, 0.0)
    return targets / sources if sources else None
