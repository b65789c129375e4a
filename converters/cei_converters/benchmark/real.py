"""`cei-benchmark real`: the paper's real-world table, in simulation: a gripper's skills on a hand and a hand's on a gripper, replayed and learnt."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from cei_converters.benchmark import real_tasks
from cei_converters.benchmark.cells import Cell
from cei_converters.benchmark.policy_stages import Stages, Training, Trials
from cei_converters.benchmark.real_found import Found
from cei_converters.benchmark.real_stages import check_robots, check_staged, conclude, policies, print_errors, replays
from cei_converters.benchmark.real_tasks import RealTask, select_tasks
from cei_converters.benchmark.replaying import Replaying, run_replays
from cei_converters.benchmark.results import Results, check_derived, check_folders
from cei_converters.benchmark.training import finished_policies, run_policies
from cei_converters.cli import run
from cei_converters.cli.options import check_range
from cei_converters.cli.table import print_markdown
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-benchmark real --stage=replay --films
  cei-benchmark real --tasks=PushCube,PickCup
  cei-benchmark real --stage=train --training.device=cuda   # elsewhere; bring --work back
  cei-benchmark real --stage=evaluate"""
CELLS = "*-*-*.json"
"""Files of cells; `anchors` and `modes` have others in the same folder."""
FILES = ("real.md", "real.csv", "real.png")
FILMS = "films"


@dataclass
class RealBenchmarkConfig:
    """The paper's real-world table, in simulation; finished cells, datasets and trainings are kept, so it resumes."""

    # replay, or policy; of policies train stops before evaluation, and evaluate trains nothing; default: replay, then policy.
    stage: str = "all"
    tasks: str | None = None  # Such as PushCube,PickCup; default: all.
    episodes: int = 20  # Demonstrations that are replayed.
    trials: int = 20  # Of each policy.
    seed: int = 2000  # Of the first demonstration that is replayed and of the first trial; development uses 0 to 1999.
    demonstrations: int = 25  # To train on, from seed 0.
    variation: float = 1.0  # How much those to train on differ: 1 as people's do, 0 not at all.
    episode_length: int = 400  # Most steps of a trial.
    training: Training = field(default_factory=Training)
    films: bool = False  # Film a demonstration of each task that is replayed, source and target side by side, into films of --results.
    jobs: int | None = None  # Cells at a time; default: one a core; policies with a GPU one.
    # Folder for a JSON a cell, for films, and for tables and picture, which are made anew each time.
    results: Path = Path("results/real_world")
    work: Path = Path("outputs/real-benchmark")  # Folder for datasets and trainings.
    redraw: bool = False  # Run nothing: tables and picture of the cells that are finished.

    def __post_init__(self) -> None:
        check_staged(self, "episodes", "trials", "episode_length", "demonstrations", running=("jobs", "stage", "films"))
        check_range("--variation", self.variation, 0, 1)
        if self.films and not replays(self.stage):
            raise CEIError(f"--films shows what is replayed, which --stage={self.stage} does not; leave one out.")


def real_benchmark(config: RealBenchmarkConfig) -> None:
    """Run the cells that are not finished; write and print the tables.

    Raises:
        CEIError: bad options, cells of other settings in the way, or some cell failed (the others are kept).
    """
    check_folders(config.results, config.work)
    tasks = select_tasks(config.tasks)
    learnt = [task for task in tasks if task.figures is not None]
    how_far = policies(config.stage)
    if config.stage != "all" and how_far and not learnt:
        raise CEIError(
            f"--tasks={config.tasks} is only replayed, as the paper has no policy's figure; use --stage=replay."
        )
    trials = Trials(config.seed, config.trials, config.episode_length)
    stages = Stages(config.work, config.demonstrations, config.variation, trials, config.training)
    found = _finished(config, stages)
    check_derived(config.results, FILES, any(config.results.glob(CELLS)))
    errors: list[str] = []
    if not config.redraw:
        check_robots(robot for task in tasks for robot in (task.source, task.target))
        if replays(config.stage):
            errors += _replay(tasks, found, config)
        if how_far:
            # What the table is for comes first.
            cells = [*(task.policy for task in learnt), *(task.own_policy for task in learnt)]
            cells = [cell for cell in cells if cell not in found.policies]
            command = _command(replace(config, stage="policy", films=False))
            errors += run_policies(cells, stages, config.results, command, how_far, config.jobs)
        found = _finished(config, stages)
    print_errors(errors)
    if found.replays or found.policies:
        _draw(found, config)
    elif how_far != "train" and not errors:
        raise CEIError(f"no cell is finished in {config.results}.")
    conclude(errors)


def _finished(config: RealBenchmarkConfig, stages: Stages) -> Found:
    """All finished cells, of whatever task: all of them make the tables."""
    replays = {
        cell: result
        for task in real_tasks.TASKS.values()
        for cell in (task.recorded, task.replayed)
        if (result := _results(task, config).read(cell)) is not None
    }
    policies = [cell for task in real_tasks.TASKS.values() for cell in (task.policy, task.own_policy)]
    return Found(replays, finished_policies(policies, stages, config.results))


def _results(task: RealTask, config: RealBenchmarkConfig) -> Results:
    return Results(config.results, range(config.seed, config.seed + config.episodes), task.source)


def _replay(tasks: list[RealTask], found: Found, config: RealBenchmarkConfig) -> list[str]:
    """Replay, and film, what is not yet; returns what went wrong, one line each."""
    films: dict[Cell, Path] = {}
    if config.films:
        films = {task.replayed: config.results / FILMS / f"{task.name}.mp4" for task in tasks}
        films = {cell: path for cell, path in films.items() if not path.exists()}
    wanted = {
        cell: _results(task, config)
        for task in tasks
        for cell in (task.recorded, task.replayed)
        if cell not in found.replays or cell in films
    }
    work = config.work / "replayed" / f"{config.seed}-{config.episodes}"
    command = _command(replace(config, stage="replay"))
    return run_replays(wanted, Replaying(work, workers=config.jobs, films=films), command)


def _draw(found: Found, config: RealBenchmarkConfig) -> None:
    from cei_converters.benchmark.keeping import keep_derived
    from cei_converters.benchmark.real_picture import draw
    from cei_converters.benchmark.real_report import write_report

    print_markdown(write_report(found, config.results))
    draw(found, config.results / FILES[-1])
    command = _command(replace(config, stage="all", tasks=None, films=False))
    keep_derived(config.results, FILES, f"{command} --redraw", CELLS)
    print(f"Wrote {', '.join(FILES)} to {config.results}.")


def _command(config: RealBenchmarkConfig) -> str:
    """The command, less where it puts things and how."""
    from cei_converters.benchmark.keeping import command_of

    return command_of("cei-benchmark real", config, "results", "work", "jobs", "redraw")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark real`."""
    return run(RealBenchmarkConfig, real_benchmark, args, prog="cei-benchmark real", example=EXAMPLE)
