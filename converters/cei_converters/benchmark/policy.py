"""`cei-benchmark policy`: how often policies trained on converted demonstrations succeed, beside the paper's figures."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from cei_converters.benchmark import paper
from cei_converters.benchmark.cells import listed
from cei_converters.benchmark.policy_stages import BLIND, VARIANTS, PolicyCell, Stages, Training, Trials
from cei_converters.benchmark.results import check_derived, check_folders
from cei_converters.benchmark.training import STAGES, finished_policies, run_policies
from cei_converters.cli import run
from cei_converters.cli.options import check_range
from cei_gym.errors import CEIError, unknown

EXAMPLE = """example:
  cei-benchmark policy --tasks=PickCube --targets=IIWA-Inspire,UR5e-FourierRight
  cei-benchmark policy --stage=train --training.device=cuda --training.size=paper   # elsewhere; bring --work back
  cei-benchmark policy --stage=evaluate"""
REPORT_FILES = ("policy.md", "policy.csv", "success.png", "learning.png")


@dataclass
class PolicyBenchmarkConfig:
    """Success of trained policies, beside the paper's; finished cells, datasets and trainings are kept, so it resumes."""

    tasks: str | None = None  # Such as PickCube,StackCube; default: all.
    targets: str | None = None  # Such as IIWA-Inspire,UR5e-FourierRight; default: the paper's four.
    variants: str | None = None  # Such as cei,no_augmentation; default: all, and the blind controls.
    variation: float = 0.25  # How much the demonstrations differ: 1 as people's do, 0 not at all.
    training_seeds: int = 1  # Trainings of each policy, with seeds 0, 1, ...
    demonstrations: int = 50  # To train on, from seed 0 (development).
    episodes: int = 20  # Trials.
    seed: int = 1000  # Of the first one; development uses 0 to 999.
    episode_length: int = 400  # Most steps of a trial.
    training: Training = field(default_factory=Training)
    stage: str = "all"  # train stops before evaluation; evaluate trains nothing.
    jobs: int | None = None  # Cells at a time; default: one a core, or one with a GPU.
    # Folder for a JSON a cell, and for table and plots, which are made anew each time.
    results: Path = Path("results/policy")
    work: Path = Path("outputs/policy-benchmark")  # Folder for datasets and trainings.
    redraw: bool = False  # Run nothing: table and plots of the cells that are finished.

    def __post_init__(self) -> None:
        if self.stage not in STAGES:
            raise unknown("--stage", self.stage, STAGES)
        for name in ("episodes", "episode_length", "demonstrations", "training_seeds", "jobs"):
            check_range(f"--{name}", getattr(self, name), 1)
        check_range("--seed", self.seed, 0)
        check_range("--variation", self.variation, 0, 1)
        if self.redraw and (self.jobs is not None or self.stage != "all"):
            raise CEIError("--redraw runs nothing; leave out --jobs and --stage.")


def policy_benchmark(config: PolicyBenchmarkConfig) -> None:
    """Run the cells that are not finished; write and print the table.

    Raises:
        CEIError: bad options, cells of other settings in the way, or some cell failed (the others are kept).
    """
    check_folders(config.results, config.work)
    trials = Trials(config.seed, config.episodes, config.episode_length)
    stages = Stages(config.work, config.demonstrations, config.variation, trials, config.training)
    cells, folder, errors = list(_cells(config)), config.results, []
    found = finished_policies(cells, stages, folder)
    check_derived(folder, REPORT_FILES, any(folder.glob("*-*-*.json")))
    if not config.redraw:
        missing = [cell for cell in cells if cell not in found]
        errors = run_policies(missing, stages, folder, _command(config), config.stage, config.jobs)
        found = finished_policies(cells, stages, folder)
    if found:
        from cei_converters.benchmark.keeping import keep_derived
        from cei_converters.benchmark.policy_report import write_report

        print(write_report(found, stages, folder))
        keep_derived(folder, REPORT_FILES, f"{_command(config)} --redraw", "*-*-*.json")
    elif config.stage != "train":
        errors.append(f"no cell is finished in {folder}.")
    if errors:
        raise CEIError(" ".join(errors) + " The same command goes on.")


def _cells(config: PolicyBenchmarkConfig) -> Iterator[PolicyCell]:
    targets = listed("target", config.targets, paper.POLICY_TARGETS)
    variants = listed("variant", config.variants, VARIANTS)
    for task in listed("task", config.tasks, paper.POLICY):
        for target in targets:
            for variant in variants:
                for seed in range(1 if variant in BLIND else config.training_seeds):
                    yield PolicyCell(task, target, variant, seed)


def _command(config: PolicyBenchmarkConfig) -> str:
    """The command, less where it puts things and how."""
    from cei_converters.benchmark.keeping import command_of

    return command_of("cei-benchmark policy", config, "results", "work", "jobs", "stage", "redraw")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-benchmark policy`."""
    return run(PolicyBenchmarkConfig, policy_benchmark, args, prog="cei-benchmark policy", example=EXAMPLE)
