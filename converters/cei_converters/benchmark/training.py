"""Running cells of policies: each is prepared and evaluated by its `Stages`, and kept at once."""

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from threading import Lock
from typing import Any

from cei_converters.benchmark.policy_stages import PolicyCell, Stages
from cei_converters.benchmark.results import read_cell
from cei_gym.errors import CEIError, one_line

STAGES = ("all", "train", "evaluate")
"""How far to go: to the end, up to training, or no further training."""


def finished_policies[C: PolicyCell](cells: Iterable[C], stages: Stages, folder: Path) -> dict[C, dict[str, Any]]:
    """Those cells whose file is in a folder, with what it says.

    Raises:
        CEIError: one was made with other settings, or cannot be read.
    """
    found = {cell: read_cell(folder / f"{cell.name}.json", stages.settings(cell)) for cell in cells}
    return {cell: result for cell, result in found.items() if result is not None}


def run_policies(
    cells: Sequence[PolicyCell], stages: Stages, folder: Path, command: str, stage: str = "all", jobs: int | None = None
) -> list[str]:
    """Run cells and keep their results; returns what went wrong, one line each.

    Args:
        cells: to run.
        stages: theirs.
        folder: of results.
        command: that runs them.
        stage: one of `STAGES`.
        jobs: cells at a time; None for one a core, or one with a GPU.
    """
    from cei_converters.benchmark.keeping import Run, keep_cell
    from cei_converters.cli.progress import progress_bar
    from cei_converters.dataset.provenance import PACKAGES

    started = Run.now((*PACKAGES, "numba", "lerobot_policy_dp3"))
    workers = jobs or (1 if stages.training.device != "cpu" else os.cpu_count() or 1)
    errors: list[str] = []
    keeping = Lock()

    def one(cell: PolicyCell) -> tuple[PolicyCell, dict[str, Any] | None, str | None]:
        try:
            stages.prepare(cell, train=stage != "evaluate")
            result = None if stage == "train" else stages.evaluate(cell)
            if result is not None:
                with keeping:  # at once: hours lie between, and what another cell dies of costs no other
                    found = stages.settings(cell) | result
                    keep_cell(folder, f"{cell.name}.json", found, command, started, stages.trials.seeds)
            return cell, result, None
        except CEIError as error:
            return cell, None, one_line(error)

    with progress_bar("cells") as progress, ThreadPoolExecutor(workers) as pool:
        bar = progress.add_task("training and evaluating", total=len(cells))
        for done in as_completed([pool.submit(one, cell) for cell in cells]):
            cell, result, error = done.result()
            if error is not None:
                errors.append(f"{cell.name}: {error}")
            elif result is not None:
                line = f"{cell.name}: {sum(result['successes'])} of {len(result['successes'])}"
                progress.console.print(line, highlight=False, markup=False, soft_wrap=True)
            progress.advance(bar)
    return errors
