"""`cei-benchmark replay`: how often transferred demonstrations succeed in physics, beside the paper's figures or for any robot."""

import contextlib
import math
import os
import sys
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cei_converters.benchmark.cells import SOURCE, Cell, select
from cei_converters.benchmark.results import Results, check_derived, check_folders
from cei_converters.benchmark.robots import (
    DATA,
    REPORT,
    beyond_the_paper,
    finished_robots,
    robot_cells,
    robots_markdown,
    rows,
)
from cei_converters.benchmark.tables import FILES
from cei_converters.cli import run
from cei_converters.cli.options import check_range
from cei_converters.cli.table import PIPE_WIDTH
from cei_gym.embodiment import check_embodiment
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-benchmark replay
  cei-benchmark replay --tasks=PickCube --targets=IIWA-Inspire,UR5e-FourierRight --episodes=2 --results=outputs/smoke
  cei-benchmark replay --tasks=PickCube --targets=UR5e-PandaGripper --episodes=2 --results=outputs/robots"""
HEAT_MAP = "heat_map.png"
DERIVED = (REPORT, HEAT_MAP, *FILES.values())
DERIVED_OF_ROBOTS = (DATA, REPORT)
# the shortest last, so that the cores finish together
LAST = ("StackCube", "OpenDrawer", "PickCube")


@dataclass
class ReplayBenchmarkConfig:
    """Replay success of transferred demonstrations, beside the paper's; finished cells are skipped, so it resumes."""

    episodes: int = 20  # Demonstrations a task.
    seed: int = 2000  # Of the first one; development uses 0 to 1999.
    tables: str | None = None  # Such as main,ablation; default: these and sensitivity.
    tasks: str | None = None  # Such as PickCube,StackCube, or a package's own; default: all of the paper's.
    # Such as IIWA-Inspire,UR5e-FourierRight; default: all of the paper's. Any robot's name, one of your own too, gives a table without the paper.
    targets: str | None = None
    source: str = SOURCE  # Whose demonstrations are recorded; it has an expert. The paper's targets have this one.
    # Folder for a JSON a cell, and for tables and heat map, which are made anew each time; default: results/replay, or results/robots for targets that
    # are not the paper's.
    results: Path | None = None
    work: Path = Path("outputs/replay-benchmark")  # Folder for datasets, which are made anew there.
    jobs: int | None = None  # Cells at a time, up to 4 GB of memory each; default: one a core.
    keep_datasets: bool = False  # Keep converted datasets, not only the recorded ones.
    redraw: bool = False  # Run nothing: tables and heat map of the cells that are finished.

    def __post_init__(self) -> None:
        for name in ("episodes", "jobs"):
            check_range(f"--{name}", getattr(self, name), 1)
        check_range("--seed", self.seed, 0)
        if self.redraw and (self.jobs is not None or self.keep_datasets):
            raise CEIError("--redraw runs nothing; leave out --jobs and --keep_datasets.")


def replay_benchmark(config: ReplayBenchmarkConfig) -> None:
    """Run the cells that are not finished; write and print the tables.

    Raises:
        CEIError: bad options, cells of other settings in the way, or some cell failed (the others are kept).
    """
    robots = beyond_the_paper(config.targets)
    if not robots and config.source != SOURCE:
        raise CEIError(f"--source={config.source} is for targets that are not the paper's; its own have {SOURCE}.")
    if robots and config.tables is not None:
        raise CEIError(f"--tables={config.tables} are the paper's, which has not all of --targets={config.targets}.")
    check_embodiment(config.source, "source")
    folder = config.results or Path("results/robots" if robots else "results/replay")
    check_folders(folder, config.work)
    cells = (
        robot_cells(config.tasks, robots, config.source)
        if robots
        else select(config.tables, config.tasks, config.targets)
    )
    results = Results(folder, range(config.seed, config.seed + config.episodes), config.source)
    # the others too: all of them make the tables
    finished = finished_robots(results) if robots else results.read_all()
    check_derived(results.folder, DERIVED_OF_ROBOTS if robots else DERIVED, bool(finished))
    errors = []
    if not config.redraw:
        errors = _run([cell for cell in cells if cell not in finished], results, config, stock=not robots)
    for error in errors:
        print(f"error: {error}", file=sys.stderr)
    (_draw_robots if robots else _draw)(results, config)
    if errors:
        raise CEIError(f"{len(errors)} failed, see above; the same command runs them again.")


def _run(cells: list[Cell], results: Results, config: ReplayBenchmarkConfig, stock: bool) -> list[str]:
    """Run cells and keep their results, those with stock physics too if asked; returns what went wrong, one line each."""
    from cei_converters.benchmark.jobs import record_source, run_cell
    from cei_converters.benchmark.keeping import Run, keep
    from cei_converters.benchmark.runner import Job, run_jobs
    from cei_converters.cli.progress import progress_bar
    from cei_converters.dataset.provenance import PACKAGES

    folder = config.work / f"{config.seed}-{config.episodes}"
    jobs = []
    for task in sorted(
        {cell.task for cell in cells}, key=lambda task: (LAST.index(task) if task in LAST else -1, task)
    ):
        how = (folder, config.keep_datasets, config.source, stock)
        then = tuple(Job(c.name, run_cell, (c, *how)) for c in cells if c.task == task)
        recording = (task, folder, results.seeds, config.source)
        jobs.append(Job(f"{task}, recording {config.source}", record_source, recording, then))
    # now, since results that are under version control will change
    started, command = Run.now((*PACKAGES, "numba")), _command(config)
    made_by = {"commit": started.commit, "versions": started.versions}
    errors = []
    with (
        progress_bar("cells") as progress,
        contextlib.closing(run_jobs(jobs, config.jobs or os.cpu_count() or 1)) as runs,
    ):
        progress.speed_estimate_period = math.inf  # a cell takes a minute or more
        bar = progress.add_task("replaying", total=len(cells))
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
                cell = job.args[0]
                results.write(cell, found | made_by | {"date": datetime.now(UTC).isoformat(timespec="seconds")})
                keep(results.folder, [results.path(cell).name], command, started, results.seeds)
                line = f"{cell.name}: {_line(found)}"
                progress.advance(bar)
            progress.console.print(line, highlight=False, markup=False, soft_wrap=True)
    return errors


def _line(found: dict[str, Any]) -> str:
    replay, stock = found["replay"], found.get("stock_replay")
    beside = f", stock physics {stock['successes']}" if stock else ""
    return f"{replay['successes']} of {replay['episodes']}{beside} ({sum(found['seconds'].values()):.0f} s)"


def _command(config: ReplayBenchmarkConfig) -> str:
    """The command, less where it puts things and how."""
    from cei_converters.benchmark.keeping import command_of

    return command_of("cei-benchmark replay", config, "results", "work", "jobs", "keep_datasets", "redraw")


def _draw(results: Results, config: ReplayBenchmarkConfig) -> None:
    """Tables and heat map of all finished cells.

    Raises:
        CEIError: there is none.
    """
    from cei_converters.benchmark.heat_map import write_heat_map
    from cei_converters.benchmark.keeping import keep_derived
    from cei_converters.benchmark.tables import markdown, write_csv

    found = results.read_all()
    if not found:
        raise CEIError(f"no cell is finished in {results.folder}.")
    text = markdown(found)
    write_csv(found, results.folder)
    (results.folder / REPORT).write_text(text + "\n")
    write_heat_map(found, results.folder / HEAT_MAP)
    command = _command(replace(config, tables=None, tasks=None, targets=None))
    keep_derived(results.folder, DERIVED, f"{command} --redraw", "*-*-*.json")
    _print(text)
    print(f"Wrote {REPORT}, {HEAT_MAP} and CSV tables to {results.folder}.")


def _draw_robots(results: Results, config: ReplayBenchmarkConfig) -> None:
    """The table of all finished cells of targets that are not the paper's.

    Raises:
        CEIError: there is none.
    """
    from cei_converters.benchmark.keeping import keep_derived
    from cei_converters.cli.outputs import Output
    from cei_converters.cli.result import write_json

    found = finished_robots(results)
    if not found:
        raise CEIError(f"no cell is finished in {results.folder}.")
    listed, commits = rows(found, config.source), {str(result["commit"]) for result in found.values()}
    text = robots_markdown(listed, config.source, commits)
    seeds = [results.seeds[0], results.seeds[-1]]
    write_json(Output(results.folder / DATA, replaces=True), {"source": config.source, "seeds": seeds, "rows": listed})
    (results.folder / REPORT).write_text(text + "\n")
    command = _command(replace(config, tasks=None))
    keep_derived(results.folder, DERIVED_OF_ROBOTS, f"{command} --redraw", "*-*-*.json")
    _print(text)
    print(f"Wrote {REPORT} and {DATA} to {results.folder}.")


def _print(text: str) -> None:
    from rich.console import Console
    from rich.markdown import Markdown

    Console(width=None if sys.stdout.isatty() else PIPE_WIDTH).print(Markdown(text))


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark replay`."""
    return run(ReplayBenchmarkConfig, replay_benchmark, args, prog="cei-benchmark replay", example=EXAMPLE)
