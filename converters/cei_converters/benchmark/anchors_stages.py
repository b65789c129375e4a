"""One demonstration of a button, pressed all over the table: the anchors, and the stages of the policy that they share."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from cei_converters.benchmark.policy_stages import PolicyCell, Stages, Training, Trials, repo_id
from cei_converters.benchmark.real_tasks import GRIPPER, HAND
from cei_converters.dataset.records import Records
from cei_converters.sources.reader import DatasetReader
from cei_gym.arrays import Array

TASK = "PressButton"
ANCHORS = tuple((x, y) for x in (-0.2, 0.0) for y in (-0.4, -0.2, 0.0, 0.2, 0.4))
"""Middles of where the button is to be pressed, world, m: 20 cm apart, those nearer to the robot first."""
RANGE_M = 0.16
"""From the first to the last place of an anchor's grid, along each axis, as in the paper."""


@dataclass(frozen=True)
class Anchor(PolicyCell):
    """The policy of all anchors, evaluated at one; `number` counts from 1."""

    task: str = TASK
    target: str = HAND
    variant: str = "cei"
    source: str = GRIPPER
    number: int = 1

    @property
    def name(self) -> str:
        """The name of its files."""
        return f"anchors_{self.number}"

    @property
    def middle_m(self) -> tuple[float, float]:
        """World, x and y."""
        return ANCHORS[self.number - 1]


@dataclass(frozen=True)
class Place:
    """An episode that was made: its index, the number of its anchor, and where its button stands, world, m."""

    episode: int
    anchor: int
    x_m: float
    y_m: float


class AnchorStages(Stages):
    """The stages of the anchors' policy: one demonstration, a grid of places around each anchor, one training.

    Args:
        work: holds datasets and trainings; of other settings elsewhere below it.
        anchors: to make demonstrations for.
        demonstration: seed of the one that is recorded.
        grid: places along each axis around each anchor.
        trials: at each anchor.
        training: options.
    """

    def __init__(
        self, work: Path, anchors: Sequence[Anchor], demonstration: int, grid: int, trials: Trials, training: Training
    ) -> None:
        numbers = [anchor.number for anchor in anchors]
        some = "" if len(numbers) == len(ANCHORS) else "-" + "_".join(map(str, numbers))
        super().__init__(work / f"anchors-{demonstration}-{grid}{some}", 1, 1.0, trials, training, demonstration)
        self.anchors, self._demonstration, self._grid = list(anchors), demonstration, grid
        self._known = Lock()  # several anchors ask at once

    @property
    def made_with(self) -> dict[str, Any]:
        """What the demonstrations must have been made with."""
        middles = [list(anchor.middle_m) for anchor in self.anchors]
        made = {"demonstration": self._demonstration, "grid": self._grid, "range_m": RANGE_M, "anchors": middles}
        return {"task": TASK, "source": GRIPPER, "target": HAND} | made

    def settings(self, cell: PolicyCell) -> dict[str, Any]:
        """What a finished anchor must have been made with to count."""
        return super().settings(cell) | self.made_with

    def conversion(self, cell: PolicyCell) -> list[str]:
        """Options of `cei-convert`: where anchors are from the recorded button; places out of reach are left out."""
        offsets = [np.subtract(anchor.middle_m, self._recorded_m) for anchor in self.anchors]
        return [
            "--augment.anchors=" + ";".join(f"{x:.6f},{y:.6f}" for x, y in offsets),
            f"--augment.grid={self._grid},{self._grid}",
            f"--augment.range={RANGE_M},{RANGE_M}",
        ]

    def environment(self, cell: PolicyCell) -> list[str]:
        """Options of `lerobot-eval`: buttons are drawn around the anchor."""
        assert isinstance(cell, Anchor)
        x, y = cell.middle_m
        return [*super().environment(cell), f'--env.arguments={{"middle_m": [{x}, {y}]}}']

    def evaluate(self, cell: PolicyCell) -> dict[str, Any]:
        """Trials at an anchor of the prepared policy; see `Stages.evaluate`. `places` are where buttons stood: x, y (world, m) and yaw (rad)."""
        assert isinstance(cell, Anchor)
        with self._known:
            drawn, base_m = self._drawn, self.base_m
        places = (drawn + [*cell.middle_m, 0.0]).round(4).tolist()
        return super().evaluate(cell) | {"places": places, "base_m": base_m}

    @property
    def base_m(self) -> list[float]:
        """Where the robot stands, world, x and y."""
        return self._made.scene.T_world_base[:2, 3].round(4).tolist()

    def places(self) -> list[Place]:
        """All episodes that were made, in order; those that the target does not reach are not among them."""
        middles = np.array([anchor.middle_m for anchor in self.anchors])
        found: list[Place] = []
        for episode, record in enumerate(Records(self._made.root)):
            offset = record["offset"]
            place = self._recorded_m + [offset["x_m"], offset["y_m"]]
            nearest = int(np.linalg.norm(middles - place, axis=1).argmin())
            found.append(Place(episode, self.anchors[nearest].number, *(float(v) for v in place.round(4))))
        return found

    @cached_property
    def _recorded_m(self) -> Array:
        """(2,) where the recorded button stands, world."""
        root = self.source(self.anchors[0])
        state = DatasetReader(repo_id(root), root).read(0, clouds=False, colours=False).environment_state
        assert state is not None
        return state[0, :2]

    @cached_property
    def _made(self) -> DatasetReader:
        root = self.converted(self.anchors[0])
        return DatasetReader(repo_id(root), root)

    @cached_property
    def _drawn(self) -> Array:
        """(trials, 3) what the trials' seeds draw around the table's middle: x, y in m, yaw in rad."""
        from cei_converters.simulation.environment import open_environment

        env = open_environment(f"CEI-{TASK}-{HAND}", clouds=False)
        states = [env.reset(seed=seed)[0]["environment_state"] for seed in self.trials.seeds]
        env.close()
        return np.array(states, float)[:, :3]
