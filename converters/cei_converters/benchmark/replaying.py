"""Running cells of replay: the source of each task is recorded, its cells follow; each that is finished is kept at once."""

import contextlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cei_converters.benchmark.cells import Cell
from cei_converters.benchmark.results import Results

# the shortest last, so that the cores finish together
LAST = ("StackCube", "OpenDrawer", "PickCube")


@dataclass(frozen=True)
class Replaying:
    """How cells are run.

    Attributes:
        work: folder for datasets, which are made anew there.
        keep_datasets: keep converted ones, not only the recorded.
        stock: replay with stock physics, too.
        workers: cells at a time; None for one a core.
        films: MP4 of cells that are to be filmed, below the folder of results; such a cell runs even if it is finished, and its result stays.
    """

    work: Path
    keep_datasets: bool = False
    stock: bool = False
    workers: int | None = None
    films: Mapping[Cell, Path] = field(default_factory=dict[Cell, Path])


def run_replays(wanted: Mapping[Cell, Results], how: Replaying, command: str) -> list[str]:
    """Run cells and keep their results; returns what went wrong, one line each.

    Args:
        wanted: each cell with where it is kept, which says seeds and source; one source a task.
        how: to run them.
        command: that runs them.
    """
    from cei_converters.benchmark.jobs import record_source
    from cei_converters.benchmark.keeping import Run
    from cei_converters.benchmark.runner import run_jobs
    from cei_converters.cli.progress import progress_bar
    from cei_converters.dataset.provenance import PACKAGES

    # now, since results that are under version control will change
    started = Run.now((*PACKAGES, "numba"))
    errors: list[str] = []
    with (
        progress_bar("cells") as progress,
        contextlib.closing(run_jobs(_jobs(wanted, how), how.workers or os.cpu_count() or 1)) as runs,
    ):
        progress.speed_estimate_period = math.inf  # a cell takes a minute or more
        bar = progress.add_task("replaying", total=len(wanted))
        for outcome in runs:
            job, found = outcome.job, outcome.result
            if outcome.error is not None:
                waiting = f" ({len(job.then)} cells wait for it)" if job.then else ""
                line = f"{job.name}: {outcome.error}{waiting}"
                errors.append(line)
            elif job.call is record_source:
                left_out = f"; the expert failed with {', '.join(map(str, found))}" if found else ""
                line = f"{job.name}: done{left_out}"
            else:
                cell: Cell = job.args[0]
                _keep(cell, found, wanted[cell], how, command, started)
                line = f"{cell.name}: {_line(found)}"
                progress.advance(bar)
            progress.console.print(line, highlight=False, markup=False, soft_wrap=True)
    return errors


def _jobs(wanted: Mapping[Cell, Results], how: Replaying) -> Sequence[Any]:
    """A job that records for each task, and those of its cells, which wait for it."""
    from cei_converters.benchmark.jobs import record_source, run_cell
    from cei_converters.benchmark.runner import Job

    jobs: list[Job] = []
    tasks = {cell.task: results for cell, results in wanted.items()}
    for task in sorted(tasks, key=lambda task: (LAST.index(task) if task in LAST else -1, task)):
        seeds, source = tasks[task].seeds, tasks[task].source
        then = tuple(
            Job(
                cell.name,
                run_cell,
                (cell, how.work, how.keep_datasets, source, how.stock, how.films.get(cell), results.perturb),
            )
            for cell, results in wanted.items()
            if cell.task == task
        )
        jobs.append(Job(f"{task}, recording {source}", record_source, (task, how.work, seeds, source), then))
    return jobs


def _keep(cell: Cell, found: dict[str, Any], results: Results, how: Replaying, command: str, started: Any) -> None:
    """Keep what a cell has made: its result, if there was none, and its film."""
    from cei_converters.benchmark.keeping import keep

    files: list[str] = []
    if not results.path(cell).exists():
        made_by = {"commit": started.commit, "versions": started.versions}
        results.write(cell, found | made_by | {"date": datetime.now(UTC).isoformat(timespec="seconds")})
        files.append(results.path(cell).name)
    if film := how.films.get(cell):
        files += [path.relative_to(results.folder).as_posix() for path in (film, film.with_suffix(".png"))]
    keep(results.folder, files, command, started, results.seeds)


def _line(found: dict[str, Any]) -> str:
    replay, stock = found["replay"], found.get("stock_replay")
    beside = f", stock physics {stock['successes']}" if stock else ""
    return f"{replay['successes']} of {replay['episodes']}{beside} ({sum(found['seconds'].values()):.0f} s)"
