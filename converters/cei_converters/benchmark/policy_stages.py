"""What a policy's cell takes, stage by stage: record, convert, train, evaluate. What is finished is not done again."""

import json
import os
import subprocess
import sys
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from cei_converters import signals
from cei_converters.benchmark.cells import SOURCE
from cei_converters.cli import parse
from cei_converters.conversion.config import ConvertConfig
from cei_converters.convert import convert
from cei_converters.record import RecordConfig, record
from cei_converters.sources.reader import DatasetReader
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


@dataclass(frozen=True)
class Training:
    """How policies are trained (DP3, by `lerobot-train`); the defaults learn on a CPU.

    Attributes:
        size: of the UNet: paper, simple or small.
        points: of each cloud; null for all, as in the paper.
        cloud_channels: of the PointNet; the paper's are 64,128,256.
        random_points: see others of each cloud every time, so that 50 demonstrations are not learnt by heart; the paper does not.
        state_noise: standard deviation of what is added to joints, in the normalised unit, for the same reason; the paper's is 0.
        steps: of training.
        batch_size: windows a step.
        lr: learning rate.
        device: of torch.
    """

    size: str = "small"
    points: int | None = 256
    cloud_channels: tuple[int, ...] = (32, 64, 128)
    random_points: bool = True
    state_noise: float = 0.3
    steps: int = 7000
    batch_size: int = 64
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
    """One policy of one task and target, trained with one seed, evaluated in one way."""

    task: str
    target: str
    variant: str
    seed: int = 0

    @property
    def name(self) -> str:
        """The name of its files."""
        return f"{self.task}-{self.target}-{self.variant}" + ("" if self.variant in BLIND else f"-{self.seed}")

    @property
    def swaps(self) -> bool:
        """Whether it is trained on clouds that show the target."""
        return self.variant != "no_augmentation"


class Stages:
    """The stages of cells that share a folder.

    Args:
        work: holds datasets and trainings.
        demonstrations: to train on, of seeds from 0.
        variation: how much they differ.
        trials: of the evaluation.
        training: options.
    """

    def __init__(self, work: Path, demonstrations: int, variation: float, trials: Trials, training: Training) -> None:
        self._work, self._demonstrations, self._variation = work, demonstrations, variation
        self._trials, self._training = trials, training
        self._locks: dict[Path, Lock] = defaultdict(Lock)  # what two cells need is made once
        self._guard = Lock()

    def settings(self, cell: PolicyCell) -> dict[str, Any]:
        """What a finished cell must have been made with to count."""
        shared = {
            **asdict(cell),
            "demonstrations": self._demonstrations,
            "variation": self._variation,
            "trials": asdict(self._trials),
        }
        if cell.variant in BLIND:
            return shared
        training = asdict(self._training) | {"cloud_channels": list(self._training.cloud_channels)}
        return shared | {"training": {key: value for key, value in training.items() if key != "device"}}

    def prepare(self, cell: PolicyCell, train: bool) -> None:
        """Record, convert and, for cells that are trained and if `train`, train.

        Raises:
            CEIError: something failed, or is missing and not to be trained.
        """
        source, converted = self._source(cell), self._converted(cell)
        with self._lock(source):
            if not source.exists():
                env, count = f"CEI-{cell.task}-{SOURCE}", self._demonstrations
                record(RecordConfig(env, _repo_id(source), source, count, 0, self._variation))
        with self._lock(converted):
            if not converted.exists():
                options = [
                    *(f"--dataset.repo_id={_repo_id(source)}", f"--dataset.root={source}", f"--target={cell.target}"),
                    *(f"--new_repo_id={_repo_id(converted)}", f"--new_root={converted}", "--allow_unreachable"),
                    f"--clouds.swap={str(cell.swaps).lower()}",
                ]
                convert(parse(ConvertConfig, options, "cei-convert", ""))
        if cell.variant not in BLIND:
            with self._lock(self.trained(cell)):
                if not self._checkpoint(cell).exists():
                    if not train:
                        raise CEIError(f"it is not trained: {self.trained(cell)} is missing.")
                    self._train(cell)

    def evaluate(self, cell: PolicyCell) -> dict[str, Any]:
        """Trials of a prepared cell: `successes`, one a seed."""
        if cell.variant in BLIND:
            return {"successes": self._blindly(cell)}
        output = self._work / "evaluated" / cell.name
        self._script(
            "lerobot-eval",
            output.with_suffix(".log"),
            f"--policy.path={self._checkpoint(cell)}",
            "--policy.device=cpu",
            "--env.type=cei",
            f"--env.dataset={self._converted(cell)}",
            f"--env.augment={str(cell.variant == 'cei').lower()}",
            f"--env.episode_length={self._trials.length}",
            f"--eval.n_episodes={self._trials.count}",
            "--eval.batch_size=1",
            f"--seed={self._trials.first_seed}",
            f"--output_dir={output}",
        )
        info = json.loads((output / "eval_info.json").read_text())
        return {"successes": info["per_task"][0]["metrics"]["successes"], "losses": self.losses(cell)}

    def trained(self, cell: PolicyCell) -> Path:
        """Folder of its training, which variants share that differ in evaluation alone."""
        kind = "swapped" if cell.swaps else "as_recorded"
        return self._work / "trained" / f"{cell.task}-{cell.target}-{kind}-{cell.seed}"

    def losses(self, cell: PolicyCell) -> list[tuple[int, float]]:
        """Step and loss, as its training's log has them; of steps done again after a stop, the later ones."""
        found: dict[float, float] = {}
        for line in self.trained(cell).with_suffix(".log").read_text().replace("\r", "\n").splitlines():
            if " loss:" in line and "updt_s:" in line:
                words = dict(word.split(":", 1) for word in line.split(" step:")[-1].split() if ":" in word)
                found[float(words["epch"])] = float(words["loss"])  # steps are in thousands there
        return [(round(self._training.steps * epoch / max(found)), found[epoch]) for epoch in sorted(found)]

    def _train(self, cell: PolicyCell) -> None:
        output, converted, t = self.trained(cell), self._converted(cell), self._training
        config = output / "checkpoints/last/pretrained_model/train_config.json"
        if config.exists():
            options = [f"--config_path={config}", "--resume=true"]
        else:
            if output.exists():  # stopped before its first checkpoint
                output.rename(_unused(output))
            options = [
                *(f"--dataset.repo_id={_repo_id(converted)}", f"--dataset.root={converted}"),
                *("--policy.type=dp3", f"--policy.size={t.size}", f"--policy.cloud_channels={list(t.cloud_channels)}"),
                *([] if t.points is None else [f"--policy.points={t.points}"]),
                *(f"--policy.random_points={str(t.random_points).lower()}", f"--policy.state_noise={t.state_noise}"),
                *(f"--policy.optimizer_lr={t.lr}", f"--policy.device={t.device}", "--policy.push_to_hub=false"),
                *(f"--policy.scheduler_warmup_steps={min(500, t.steps // 20)}", f"--batch_size={t.batch_size}"),
                *(f"--steps={t.steps}", f"--save_freq={max(1, t.steps // 8)}", f"--log_freq={max(1, t.steps // 40)}"),
                *("--num_workers=0", f"--seed={cell.seed}", f"--output_dir={output}"),
            ]
        self._script("lerobot-train", output.with_suffix(".log"), *options)

    def _blindly(self, cell: PolicyCell) -> list[bool]:
        import gymnasium as gym

        import cei_gym  # noqa: F401  (registers the environments)

        demonstrations = DatasetReader(_repo_id(self._converted(cell)), self._converted(cell))
        actions = demonstrations.read(0).action
        if cell.variant == "mean_action":
            means = [demonstrations.read(i).action.mean(axis=0) for i in range(self._demonstrations)]
            actions = np.mean(means, axis=0, keepdims=True)
        assert demonstrations.metadata is not None
        environment = demonstrations.metadata.environment
        options = environment.kwargs | {"clouds": False, "max_episode_steps": self._trials.length}
        env = gym.make(str(environment.id), **options)
        successes = []
        for seed in self._trials.seeds:
            env.reset(seed=seed)
            t, over, success = 0, False, False
            while not over:
                _, _, success, truncated, _ = env.step(actions[min(t, len(actions) - 1)].astype(np.float32))
                t, over = t + 1, success or truncated
            successes.append(bool(success))
        env.close()
        return successes

    def _script(self, name: str, log: Path, *options: str) -> None:
        """Run one of LeRobot's scripts; what it prints goes to a file."""
        log.parent.mkdir(parents=True, exist_ok=True)
        threads = {} if self._training.device != "cpu" else {"OMP_NUM_THREADS": "1"}
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

    def _source(self, cell: PolicyCell) -> Path:
        return self._work / "datasets" / f"{cell.task}-{SOURCE}"

    def _converted(self, cell: PolicyCell) -> Path:
        return self._work / "datasets" / f"{cell.task}-{cell.target}-{'swapped' if cell.swaps else 'as_recorded'}"

    def _checkpoint(self, cell: PolicyCell) -> Path:
        return self.trained(cell) / "checkpoints" / f"{self._training.steps:06d}" / "pretrained_model"


def _repo_id(root: Path) -> str:
    return f"cei-benchmark/{root.name}"


def _unused(path: Path) -> Path:
    return next(p for i in range(1, 1000) if not (p := path.with_name(f"{path.name}-stopped-{i}")).exists())
