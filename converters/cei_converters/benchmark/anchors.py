"""`cei-benchmark anchors`: one demonstration of a button becomes a thousand, all over the table; replayed and learnt."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from cei_converters.benchmark import anchors_replay
from cei_converters.benchmark.anchors_report import DATA, TABLE, Found, every_anchor
from cei_converters.benchmark.anchors_stages import Anchor, AnchorStages
from cei_converters.benchmark.cells import listed
from cei_converters.benchmark.policy_stages import Training, Trials
from cei_converters.benchmark.real_stages import check_robots, check_staged, conclude, policies, print_errors, replays
from cei_converters.benchmark.results import check_derived, check_folders, read_cell
from cei_converters.benchmark.training import finished_policies, run_policies
from cei_converters.cli import run
from cei_converters.cli.options import check_range
from cei_converters.cli.table import print_markdown
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-benchmark anchors --stage=replay
  cei-benchmark anchors"""
CELLS = "anchors_*.json"
FILES = (DATA, TABLE, "anchors.png")


@dataclass
class AnchorsConfig:
    """The paper's spatial generalisation: one demonstration pressed all over the table; what is finished is kept, so it resumes."""

    # replay, or policy; of policies train stops before evaluation, and evaluate trains nothing; default: replay, then policy.
    stage: str = "all"
    demonstration: int = 0  # Seed of the one that is recorded.
    anchors: str | None = None  # Numbers of those to make demonstrations for and to try, such as 1,2; default: all ten.
    grid: int = 10  # Places along each axis around each anchor.
    trials: int = 5  # At each anchor; as many demonstrations are replayed.
    seed: int = 2000  # Of the first trial at each anchor.
    episode_length: int = 400  # Most steps of a trial.
    training: Training = field(default_factory=Training)
    jobs: int | None = None  # Anchors at a time; default: one a core; with a GPU one.
    # Folder for a JSON an anchor, and for table and map, which are made anew each time.
    results: Path = Path("results/real_world")
    work: Path = Path("outputs/real-benchmark")  # Folder for datasets and trainings.
    redraw: bool = False  # Run nothing: table and map of what is finished.

    def __post_init__(self) -> None:
        check_staged(self, "grid", "trials", "episode_length")
        check_range("--demonstration", self.demonstration, 0)


def anchors_benchmark(config: AnchorsConfig) -> None:
    """Run what is not finished; write and print table and map.

    Raises:
        CEIError: bad options, results of other settings in the way, or something failed (the rest is kept).
    """
    check_folders(config.results, config.work)
    wanted = _selected(config.anchors)
    trials = Trials(config.seed, config.trials, config.episode_length)
    stages = AnchorStages(config.work, wanted, config.demonstration, config.grid, trials, config.training)
    found = _finished(stages, config)
    check_derived(config.results, FILES, any(config.results.glob(CELLS)))
    errors: list[str] = []
    how_far = policies(config.stage)
    if not config.redraw:
        left = [anchor for anchor in wanted if anchor not in found.policies] if how_far else []
        to_replay = replays(config.stage) and found.replay is None
        if left or to_replay:
            check_robots((wanted[0].source, wanted[0].target))
        if to_replay:
            _replay(stages, config)
        if left:
            stages.prepare(left[0], train=how_far != "evaluate")  # they share it
            if how_far != "train":
                command = _command(replace(config, stage="policy"))
                errors = run_policies(left, stages, config.results, command, "evaluate", config.jobs)
        found = _finished(stages, config)
    print_errors(errors)
    if found.any is not None:
        _draw(found, config)
    elif how_far != "train" and not errors:
        raise CEIError(f"nothing is finished in {config.results}.")
    conclude(errors)


def _selected(anchors: str | None) -> list[Anchor]:
    """Those of a list of numbers.

    Raises:
        CEIError: there is no such number.
    """
    every = {str(anchor.number): anchor for anchor in every_anchor()}
    return [every[name] for name in listed("anchor", anchors, every)]


def _finished(stages: AnchorStages, config: AnchorsConfig) -> Found:
    settings = anchors_replay.settings(stages, config.trials)
    replayed = read_cell(config.results / anchors_replay.NAME, settings)
    return Found(replayed, finished_policies(stages.anchors, stages, config.results))


def _replay(stages: AnchorStages, config: AnchorsConfig) -> None:
    from cei_converters.benchmark.keeping import Run, keep_cell
    from cei_converters.dataset.provenance import PACKAGES

    started = Run.now((*PACKAGES, "numba"))
    stages.make(stages.anchors[0])
    result = anchors_replay.settings(stages, config.trials) | anchors_replay.replay_anchors(stages, config.trials)
    command = _command(replace(config, stage="replay"))
    keep_cell(config.results, anchors_replay.NAME, result, command, started, [config.demonstration] * 2)


def _draw(found: Found, config: AnchorsConfig) -> None:
    from cei_converters.benchmark.anchors_picture import draw
    from cei_converters.benchmark.anchors_report import write_report
    from cei_converters.benchmark.keeping import keep_derived

    print_markdown(write_report(found, config.results))
    draw(found, config.results / FILES[-1])
    keep_derived(config.results, FILES, f"{_command(replace(config, stage='all'))} --redraw", CELLS)
    print(f"Wrote {', '.join(FILES)} to {config.results}.")


def _command(config: AnchorsConfig) -> str:
    """The command, less where it puts things and how."""
    from cei_converters.benchmark.keeping import command_of

    return command_of("cei-benchmark anchors", config, "results", "work", "jobs", "redraw")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark anchors`."""
    return run(AnchorsConfig, anchors_benchmark, args, prog="cei-benchmark anchors", example=EXAMPLE)
