"""`cei-benchmark replay`: how often transferred demonstrations succeed in physics, beside the paper's figures or for any robot."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

from cei_converters.benchmark.cells import SOURCE, select
from cei_converters.benchmark.replaying import Replaying, run_replays
from cei_converters.benchmark.results import Results, check_derived, check_folders
from cei_converters.benchmark.robots import (
    DATA,
    REPORT,
    beyond_the_paper,
    finished_robots,
    robot_cells,
    robots_markdown,
    rows,
    sources,
)
from cei_converters.benchmark.tables import FILES
from cei_converters.cli import run
from cei_converters.cli.options import check_range
from cei_converters.cli.table import print_markdown
from cei_gym.embodiment import check_embodiment
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-benchmark replay
  cei-benchmark replay --tasks=PickCube --targets=IIWA-Inspire,UR5e-FourierRight --episodes=2 --results=outputs/smoke
  cei-benchmark replay --tasks=PickCube --targets=UR5e-PandaGripper --episodes=2 --results=outputs/robots
  cei-benchmark replay --tasks=PushCube,PlaceBird --source=UR5e-AG95 --episodes=5 --results=outputs/tasks"""
HEAT_MAP = "heat_map.png"
DERIVED = (REPORT, HEAT_MAP, *FILES.values())
DERIVED_OF_ROBOTS = (DATA, REPORT)


@dataclass
class ReplayBenchmarkConfig:
    """Replay success of transferred demonstrations, beside the paper's; finished cells are skipped, so it resumes."""

    episodes: int = 20  # Demonstrations a task.
    seed: int = 2000  # Of the first one; development uses 0 to 1999.
    tables: str | None = None  # Such as main,ablation; default: these and sensitivity.
    # Such as PickCube,StackCube, or any other that has environments; default: the paper's. None of the paper's gives a table without the paper.
    tasks: str | None = None
    # Such as IIWA-Inspire,UR5e-FourierRight; default: the paper's. Any robot's name, one of your own too, gives a table without the paper.
    targets: str | None = None
    source: str = SOURCE  # Whose demonstrations are recorded; it has an expert. One that is not the paper's gives a table without the paper.
    # Folder for a JSON a cell, and for tables and heat map, which are made anew each time; default: results/replay, or results/robots for a table
    # without the paper.
    results: Path | None = None
    work: Path = Path("outputs/replay-benchmark")  # Folder for datasets, which are made anew there.
    # Also replay each so many times slightly otherwise, as cei-replay does, and show the share that holds.
    perturb: int = 0
    refine: bool = False  # Also convert with --refine. It gives a table without the paper.
    jobs: int | None = None  # Cells at a time, up to 4 GB of memory each; default: one a core.
    keep_datasets: bool = False  # Keep converted datasets, not only the recorded ones.
    redraw: bool = False  # Run nothing: tables and heat map of the cells that are finished.

    def __post_init__(self) -> None:
        for name in ("episodes", "jobs"):
            check_range(f"--{name}", getattr(self, name), 1)
        for name in ("seed", "perturb"):
            check_range(f"--{name}", getattr(self, name), 0)
        if self.redraw and (self.jobs is not None or self.keep_datasets):
            raise CEIError("--redraw runs nothing; leave out --jobs and --keep_datasets.")


def replay_benchmark(config: ReplayBenchmarkConfig) -> None:
    """Run the cells that are not finished; write and print the tables.

    Raises:
        CEIError: bad options, cells of other settings in the way, or some cell failed (the others are kept).
    """
    check_embodiment(config.source, "source")
    robots = beyond_the_paper(config.targets, config.tasks, config.source, config.refine)
    if robots and config.tables is not None:
        raise CEIError(
            f"--tables={config.tables} are the paper's, which have no place for these targets, tasks or this source; leave it out."
        )
    folder = config.results or Path("results/robots" if robots else "results/replay")
    check_folders(folder, config.work)
    cells = (
        robot_cells(config.tasks, robots, config.source, config.refine)
        if robots
        else select(config.tables, config.tasks, config.targets)
    )
    results = Results(folder, range(config.seed, config.seed + config.episodes), config.source, config.perturb)
    # the others too: all of them make the tables
    finished = finished_robots(results) if robots else results.read_all()
    check_derived(results.folder, DERIVED_OF_ROBOTS if robots else DERIVED, bool(finished))
    errors = []
    if not config.redraw:
        wanted = {cell: results for cell in cells if results.read(cell) is None}
        of_source = "" if config.source == SOURCE else f"-{config.source}"
        work = config.work / f"{config.seed}-{config.episodes}{of_source}"
        how = Replaying(work, config.keep_datasets, not robots, config.jobs)
        errors = run_replays(wanted, how, _command(config))
    for error in errors:
        print(f"error: {error}", file=sys.stderr)
    (_draw_robots if robots else _draw)(results, config)
    if errors:
        raise CEIError(f"{len(errors)} failed, see above; the same command runs them again.")


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
    print_markdown(text)
    print(f"Wrote {REPORT}, {HEAT_MAP} and CSV tables to {results.folder}.")


def _draw_robots(results: Results, config: ReplayBenchmarkConfig) -> None:
    """The table of all finished cells, without the paper.

    Raises:
        CEIError: there is none.
    """
    from cei_converters.benchmark.keeping import keep_derived
    from cei_converters.cli.outputs import Output
    from cei_converters.cli.result import write_json

    found = finished_robots(results)
    if not found:
        raise CEIError(f"no cell is finished in {results.folder}.")
    listed, commits = rows(found), {str(result["commit"]) for result in found.values()}
    text = robots_markdown(listed, commits)
    data = {"source": ",".join(sources(listed)), "seeds": [results.seeds[0], results.seeds[-1]], "rows": listed}
    write_json(Output(results.folder / DATA, replaces=True), data)
    (results.folder / REPORT).write_text(text + "\n")
    # the tasks too where it is they that the paper does not have
    tasks = None if beyond_the_paper(config.targets, None, config.source, config.refine) else config.tasks
    command = _command(replace(config, tasks=tasks))
    keep_derived(results.folder, DERIVED_OF_ROBOTS, f"{command} --redraw", "*-*-*.json")
    print_markdown(text)
    print(f"Wrote {REPORT} and {DATA} to {results.folder}.")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark replay`."""
    return run(ReplayBenchmarkConfig, replay_benchmark, args, prog="cei-benchmark replay", example=EXAMPLE)
