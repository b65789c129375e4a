"""What a policy's cell takes, stage by stage: record, convert, train, evaluate. What is finished is not done again.

A cell whose target is its source is the source's own policy: nothing is converted, and clouds are as cameras see them.
"""

import json
import os
import subprocess
import sys
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock
from typing import Any

from cei_converters import signals
from cei_converters.benchmark.blind import blindly
from cei_converters.benchmark.cells import SOURCE
from cei_converters.benchmark.jobs import record_successes, recorded_seeds
from cei_converters.benchmark.own_clouds import with_own_clouds
from cei_converters.cli import DatasetConfig, parse
from cei_converters.conversion.config import ConvertConfig
from cei_converters.convert import convert
from cei_converters.record import RecordConfig
from cei_gym.errors import CEIError

BLIND = ("mean_action", "one_demonstration")
VARIANTS = {
    "no_augmentation": "no augmentation",
    "no_inference_augmentation": "without inference augmentation",
    "cei": "CEI",
    "mean_action": "blind: the mean action",
    "one_demonstration": "blind: one demonstration",
}
"""Variant to what it is called. The first trains on clouds that still show the source; the first two are evaluated on clouds as
cameras see them. The last two look at nothing."""
OWN = "source"
"""The variant of the source's own policy."""


@dataclass(frozen=True)
class Training:
    """How policies are trained (DP3, by `lerobot-train`); the defaults learn on a CPU.

    Attributes:
        size: of the UNet: paper, simple or small.
        n_obs_steps: observations that an action depends on; the paper's are 2.
        horizon: actions predicted at once; the paper's are 16.
        points: of each cloud; null for all, as in the paper: of 256, a toy bird beside a hand and its arm has four.
        cloud_channels: of the PointNet; the paper's are 64,128,256.
        random_points: see others of each cloud every time, where they are not all looked at; the paper does not.
        state_noise: standard deviation of what is added to joints, in the normalised unit, so that demonstrations are not learnt by heart; the
            paper's is 0.
        steps: of training.
        batch_size: windows a step.
        lr: learning rate.
        device: of torch.
    """

    size: str = "small"
    n_obs_steps: int = 1
    horizon: int = 8
    points: int | None = None
    cloud_channels: tuple[int, ...] = (32, 64, 128)
    random_points: bool = False
    state_noise: float = 0.1
    steps: int = 12000
    batch_size: int = 32
    lr: float = 1e-3
    device: str = "cpu"


@dataclass(frozen=True)
class Trials:
    """What policies are evaluated on: `count` episodes of seeds from `first_seed` on, of at most `length` steps."""

    first_seed: int
    count: int
    length: int

    @property
    def seeds(self) -> range:
        """One an episode."""
        return range(self.first_seed, self.first_seed + self.count)


@dataclass(frozen=True)
class PolicyCell:
    """One policy of one task and target, trained with one seed, evaluated in one way, from demonstrations of one source."""

    task: str
    target: str
    variant: str
    seed: int = 0
    source: str = SOURCE

    @property
    def name(self) -> str:
        """The name of its files."""
        return f"{self.task}-{self.target}-{self.variant}" + ("" if self.variant in BLIND else f"-{self.seed}")

    @property
    def swaps(self) -> bool:
        """Whether it is trained on clouds that show the target."""
        return self.variant not in ("no_augmentation", OWN)

    @property
    def dataset(self) -> str:
        """Name of what it is trained on."""
        of_source = "" if self.source in (SOURCE, self.target) else f"-of-{self.source}"
        return f"{self.task}-{self.target}{of_source}-{'swapped' if self.swaps else 'as_recorded'}"

    @property
    def sees_swapped(self) -> bool:
        """Whether it is evaluated on clouds as conversions make them."""
        return self.variant == "cei"


class Stages:
    """The stages of cells that share a folder.

    Args:
        work: holds datasets and trainings.
        demonstrations: to train on.
        variation: how much they differ.
        trials: of the evaluation.
        training: options.
        first: seed of the first demonstration.

    Attributes:
        trials, training: as given.
    """

    def __init__(
        self, work: Path, demonstrations: int, variation: float, trials: Trials, training: Training, first: int = 0
    ) -> None:
        self._work, self._demonstrations, self._variation, self._first = work, demonstrations, variation, first
        self.trials, self.training = trials, training
        self._locks: dict[Path, Lock] = defaultdict(Lock)  # what two cells need is made once
        self._guard = Lock()

    def settings(self, cell: PolicyCell) -> dict[str, Any]:
        """What a finished cell must have been made with to count."""
        shared = {
            **asdict(cell),
            "demonstrations": self._demonstrations,
            "variation": self._variation,
            "trials": asdict(self.trials),
        }
        if cell.variant in BLIND:
            return shared
        training = asdict(self.training) | {"cloud_channels": list(self.training.cloud_channels)}
        return shared | {"training": {key: value for key, value in training.items() if key != "device"}}

    def conversion(self, cell: PolicyCell) -> list[str]:
        """Options of `cei-convert` for a cell, once its source's demonstrations are recorded."""
        return ["--allow_unreachable", "--drop_strays", f"--clouds.swap={str(cell.swaps).lower()}"]

    def environment(self, cell: PolicyCell) -> list[str]:
        """Options of `lerobot-eval` for the environment that a cell is evaluated in."""
        return [f"--env.augment={str(cell.sees_swapped).lower()}"]

    def make(self, cell: PolicyCell) -> None:
        """Record and convert.

        Raises:
            CEIError: something failed.
        """
        source, converted = self.source(cell), self.converted(cell)
        with self._lock(source):
            if not source.exists():
                env, count = f"CEI-{cell.task}-{cell.source}", self._demonstrations
                record_successes(RecordConfig(env, repo_id(source), source, count, self._first, self._variation))
        with self._lock(converted):
            if not converted.exists() and cell.variant == OWN:
                with_own_clouds(DatasetConfig(repo_id(source), source), DatasetConfig(repo_id(converted), converted))
            elif not converted.exists():
                options = [
                    *(f"--dataset.repo_id={repo_id(source)}", f"--dataset.root={source}", f"--target={cell.target}"),
                    *(f"--new_repo_id={repo_id(converted)}", f"--new_root={converted}", *self.conversion(cell)),
                    "--resume",  # one that was interrupted
                ]
                convert(parse(ConvertConfig, options, "cei-convert", ""))

    def prepare(self, cell: PolicyCell, train: bool) -> None:
        """Make what a cell is trained on and, for cells that are trained and if `train`, train.

        Raises:
            CEIError: something failed, or is missing and not to be trained.
        """
        self.make(cell)
        if cell.variant not in BLIND:
            with self._lock(self.trained(cell)):
                if not self._checkpoint(cell).exists():
                    if not train:
                        raise CEIError(f"it is not trained: {self.trained(cell)} is missing.")
                    self._train(cell)

    def evaluate(self, cell: PolicyCell) -> dict[str, Any]:
        """Trials of a prepared cell: `successes`, one a seed, and the seeds of the demonstrations behind it, without those that the expert
        failed with."""
        trained_on = {"source_seeds": recorded_seeds(self.source(cell))}
        if cell.variant in BLIND:
            dataset = DatasetConfig(repo_id(self.converted(cell)), self.converted(cell))
            mean = cell.variant == "mean_action"
            return {"successes": blindly(dataset, mean, self.trials.seeds, self.trials.length), **trained_on}
        output = self._work / "evaluated" / cell.name
        self._script(
            "lerobot-eval",
            output.with_suffix(".log"),
            f"--policy.path={self._checkpoint(cell)}",
            "--policy.device=cpu",
            "--env.type=cei",
            f"--env.dataset={self.converted(cell)}",
            *self.environment(cell),
            f"--env.episode_length={self.trials.length}",
            f"--eval.n_episodes={self.trials.count}",
            "--eval.batch_size=1",
            f"--seed={self.trials.first_seed}",
            f"--output_dir={output}",
        )
        info = json.loads((output / "eval_info.json").read_text())
        successes = info["per_task"][0]["metrics"]["successes"]
        return {"successes": successes, "losses": self.losses(cell), **trained_on}

    def source(self, cell: PolicyCell) -> Path:
        """Folder of its source's demonstrations."""
        return self._work / "datasets" / f"{cell.task}-{cell.source}"

    def converted(self, cell: PolicyCell) -> Path:
        """Folder of what it is trained on."""
        return self._work / "datasets" / cell.dataset

    def trained(self, cell: PolicyCell) -> Path:
        """Folder of its training, which variants share that differ in evaluation alone."""
        return self._work / "trained" / f"{cell.dataset}-{cell.seed}"

    def losses(self, cell: PolicyCell) -> list[tuple[int, float]]:
        """Step and loss, as its training's log has them; of steps done again after a stop, the later ones."""
        found: dict[float, float] = {}
        for line in self.trained(cell).with_suffix(".log").read_text().replace("\r", "\n").splitlines():
            if " loss:" in line and "updt_s:" in line:
                words = dict(word.split(":", 1) for word in line.split(" step:")[-1].split() if ":" in word)
                found[float(words["epch"])] = float(words["loss"])  # steps are in thousands there
        return [(round(self.training.steps * epoch / max(found)), found[epoch]) for epoch in sorted(found)]

    def _train(self, cell: PolicyCell) -> None:
        output, converted, t = self.trained(cell), self.converted(cell), self.training
        config = output / "checkpoints/last/pretrained_model/train_config.json"
        if config.exists():
            options = [f"--config_path={config}", "--resume=true"]
        else:
            if output.exists():  # stopped before its first checkpoint
                output.rename(_unused(output))
            options = [
                *(f"--dataset.repo_id={repo_id(converted)}", f"--dataset.root={converted}"),
                *("--policy.type=dp3", f"--policy.size={t.size}", f"--policy.cloud_channels={list(t.cloud_channels)}"),
                *(f"--policy.n_obs_steps={t.n_obs_steps}", f"--policy.horizon={t.horizon}"),
                *([] if t.points is None else [f"--policy.points={t.points}"]),
                *(f"--policy.random_points={str(t.random_points).lower()}", f"--policy.state_noise={t.state_noise}"),
                *(f"--policy.optimizer_lr={t.lr}", f"--policy.device={t.device}", "--policy.push_to_hub=false"),
                *(f"--policy.scheduler_warmup_steps={min(500, t.steps // 20)}", f"--batch_size={t.batch_size}"),
                *(f"--steps={t.steps}", f"--save_freq={max(1, t.steps // 8)}", f"--log_freq={max(1, t.steps // 40)}"),
                *("--num_workers=0", f"--seed={cell.seed}", f"--output_dir={output}"),
            ]
        self._script("lerobot-train", output.with_suffix(".log"), *options)

    def _script(self, name: str, log: Path, *options: str) -> None:
        """Run one of LeRobot's scripts; what it prints goes to a file."""
        log.parent.mkdir(parents=True, exist_ok=True)
        threads = {} if self.training.device != "cpu" else {"OMP_NUM_THREADS": "1"}
        with log.open("a") as file:
            script = Path(sys.executable).with_name(name)
            process = subprocess.Popen(
                [script, *options], stdout=file, stderr=subprocess.STDOUT, env=os.environ | threads
            )
            with signals.unfinished(process.terminate):  # nobody waits for it then
                code = process.wait()
        if code != 0:
            raise CEIError(f"{name} failed, see {log}.")

    def _lock(self, path: Path) -> Lock:
        with self._guard:
            return self._locks[path]

    def _checkpoint(self, cell: PolicyCell) -> Path:
        return self.trained(cell) / "checkpoints" / f"{self.training.steps:06d}" / "pretrained_model"


def repo_id(root: Path) -> str:
    """What a dataset in a folder is called."""
    return f"cei-benchmark/{root.name}"


def _unused(path: Path) -> Path:
    return next(p for i in range(1, 1000) if not (p := path.with_name(f"{path.name}-stopped-{i}")).exists())
