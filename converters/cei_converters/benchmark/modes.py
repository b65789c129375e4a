"""`cei-benchmark modes`: two motions of a hand from one demonstration of a gripper; replayed, and learnt apart and together."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from cei_converters.benchmark import modes_replay
from cei_converters.benchmark.cells import listed
from cei_converters.benchmark.modes_report import DATA, TABLE, Found
from cei_converters.benchmark.modes_stages import PATTERNS, ModeStages, Pattern
from cei_converters.benchmark.policy_stages import Training, Trials
from cei_converters.benchmark.real_stages import check_robots, check_staged, conclude, policies, print_errors, replays
from cei_converters.benchmark.real_tasks import GRIPPER, HAND
from cei_converters.benchmark.results import check_derived, check_folders, read_cell
from cei_converters.benchmark.training import finished_policies, run_policies
from cei_converters.cli import run
from cei_converters.cli.table import print_markdown
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-benchmark modes --stage=replay
  cei-benchmark modes"""
CELLS = "modes_*.json"
FILES = (DATA, TABLE)


@dataclass
class ModesConfig:
    """The paper's two motions of OpenDrawer from the same demonstrations; what is finished is kept, so it resumes."""

    # replay, or policy; of policies train stops before evaluation, and evaluate trains nothing; default: replay, then policy.
    stage: str = "all"
    patterns: str | None = None  # Whose policies, such as pattern_1,mixture; default: all three.
    episodes: int = 20  # Demonstrations that are replayed in both motions.
    trials: int = 20  # Of each policy.
    seed: int = 2000  # Of the first demonstration that is replayed and of the first trial; development uses 0 to 1999.
    demonstrations: int = 25  # To train on, from seed 0.
    episode_length: int = 400  # Most steps of a trial.
    training: Training = field(default_factory=Training)
    jobs: int | None = None  # Policies at a time; default: one a core; with a GPU one.
    # Folder for a JSON a pattern, the picture of both motions, and for the table, which is made anew each time.
    results: Path = Path("results/real_world")
    work: Path = Path("outputs/real-benchmark")  # Folder for datasets and trainings.
    redraw: bool = False  # Run nothing: the table of what is finished.

    def __post_init__(self) -> None:
        check_staged(self, "episodes", "trials", "episode_length", "demonstrations")


def modes_benchmark(config: ModesConfig) -> None:
    """Run what is not finished; write and print the table.

    Raises:
        CEIError: bad options, results of other settings in the way, or something failed (the rest is kept).
    """
    check_folders(config.results, config.work)
    wanted = [Pattern(variant=name) for name in listed("pattern", config.patterns, PATTERNS)]
    trials = Trials(config.seed, config.trials, config.episode_length)
    stages = ModeStages(config.work, config.demonstrations, 1.0, trials, config.training)
    found = _finished(stages, config)
    check_derived(config.results, (*FILES, modes_replay.PICTURE), any(config.results.glob(CELLS)))
    errors: list[str] = []
    how_far = policies(config.stage)
    if not config.redraw:
        left = [pattern for pattern in wanted if pattern not in found.policies] if how_far else []
        to_replay = replays(config.stage) and found.replay is None
        if left or to_replay:
            check_robots((GRIPPER, HAND))
        if to_replay:
            _replay(config)
        if left and how_far:
            command = _command(replace(config, stage="policy"))
            errors = run_policies(left, stages, config.results, command, how_far, config.jobs)
        found = _finished(stages, config)
    print_errors(errors)
    if not found.is_empty:
        _draw(found, config)
    elif how_far != "train" and not errors:
        raise CEIError(f"nothing is finished in {config.results}.")
    conclude(errors)


def _finished(stages: ModeStages, config: ModesConfig) -> Found:
    replayed = read_cell(config.results / modes_replay.NAME, modes_replay.settings(_seeds(config)))
    every = [Pattern(variant=name) for name in PATTERNS]
    return Found(replayed, finished_policies(every, stages, config.results))


def _seeds(config: ModesConfig) -> range:
    return range(config.seed, config.seed + config.episodes)


def _replay(config: ModesConfig) -> None:
    from cei_converters.benchmark.keeping import Run, keep_cell
    from cei_converters.dataset.provenance import PACKAGES

    started, seeds = Run.now((*PACKAGES, "numba")), _seeds(config)
    work = config.work / "replayed" / f"{seeds[0]}-{len(seeds)}"
    found = modes_replay.replay_modes(seeds, work, config.results / modes_replay.PICTURE)
    command = _command(replace(config, stage="replay"))
    result = modes_replay.settings(seeds) | found
    keep_cell(config.results, modes_replay.NAME, result, command, started, seeds, modes_replay.PICTURE)


def _draw(found: Found, config: ModesConfig) -> None:
    from cei_converters.benchmark.keeping import keep_derived
    from cei_converters.benchmark.modes_report import write_report

    print_markdown(write_report(found, config.results))
    command = _command(replace(config, stage="all", patterns=None))
    keep_derived(config.results, FILES, f"{command} --redraw", CELLS)
    print(f"Wrote {', '.join(FILES)} to {config.results}.")


def _command(config: ModesConfig) -> str:
    """The command, less where it puts things and how."""
    from cei_converters.benchmark.keeping import command_of

    return command_of("cei-benchmark modes", config, "results", "work", "jobs", "redraw")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark modes`."""
    return run(ModesConfig, modes_benchmark, args, prog="cei-benchmark modes", example=EXAMPLE)
