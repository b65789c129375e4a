"""Reading and training: samples a second of a converted dataset, steps a second of DP3, and the loader's share of a step.

usage: python benchmarks/training.py [--target IIWA-Inspire] [--demonstrations 10] [--results DIR]

Demonstrations of PickCube (seeds 0-9) are recorded and converted. LeRobot's reader and ours then read the same samples, in DP3's windows,
in one process on one core. For each size of DP3 a few steps at batch 64 are timed on one core, in halves: batch and update. Writes
training.json.
"""

import argparse
import tempfile
from pathlib import Path
from time import perf_counter

import gymnasium as gym
import numpy as np
import torch
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_policy, make_pre_post_processors
from measure import save
from tqdm import tqdm

import cei_gym  # noqa: F401  (registers the environments)
import lerobot_policy_dp3
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.simulation.rollout import record_episode
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer
from lerobot_policy_dp3.fast_reader import FastReader

SOURCE, BATCH = "Panda-PandaGripper", 64
POLICIES = {
    "small, 256 points": {"size": "small", "points": 256},
    "small, all points": {"size": "small"},
    "simple, 256 points": {"size": "simple", "points": 256},
}


def convert(root: Path, target: str, count: int) -> None:
    env = gym.make(f"CEI-PickCube-{SOURCE}")
    recorded = [record_episode(env, seed, seed)[0] for seed in tqdm(range(count), "recording")]
    transfer = Transfer(load_embodiment(SOURCE), load_embodiment(target))
    transfer.fit(recorded[:6])
    with DatasetWriter("benchmark/converted", root) as writer:
        for demonstration in tqdm(recorded, "converting"):
            writer.add(transfer(demonstration)[0])


def opened(root: Path, reader: type[DatasetReader]) -> LeRobotDataset:
    """The dataset, in DP3's windows, read in one way or the other."""
    lerobot_dataset.DatasetReader = reader
    meta = LeRobotDataset("benchmark/converted", root=root).meta
    windows = resolve_delta_timestamps(lerobot_policy_dp3.DP3Config(device="cpu"), meta)
    return LeRobotDataset("benchmark/converted", root=root, delta_timestamps=windows)


def samples_per_s(dataset: LeRobotDataset, count: int) -> float:
    order = np.random.default_rng(0).permutation(len(dataset))[:count].tolist()
    dataset[order[0]]
    start = perf_counter()
    for i in order:
        dataset[i]
    return len(order) / (perf_counter() - start)


def training(dataset: LeRobotDataset, options: dict, steps: int) -> dict[str, float]:
    """Seconds of a step's batch and update, as `lerobot-train` takes them."""
    config = lerobot_policy_dp3.DP3Config(device="cpu", **options)
    policy = make_policy(config, ds_meta=dataset.meta).train()
    assert isinstance(policy, lerobot_policy_dp3.DP3Policy)
    before, _ = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    optimizer = config.get_optimizer_preset().build(policy.get_optim_params())
    loader = iter(torch.utils.data.DataLoader(dataset, batch_size=BATCH, shuffle=True, drop_last=True))
    batch_s, update_s = [], []
    for _ in range(steps + 1):
        start = perf_counter()
        batch = before(next(loader))
        read = perf_counter()
        loss, _ = policy(batch)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        policy.update()
        batch_s.append(read - start)
        update_s.append(perf_counter() - read)
    batch_median, update_median = float(np.median(batch_s[1:])), float(np.median(update_s[1:]))
    return {
        "weights": sum(weight.numel() for weight in policy.model.parameters()),
        "batch_s": round(batch_median, 4),
        "update_s": round(update_median, 4),
        "steps_per_s": round(1 / (batch_median + update_median), 2),
        "loader_share": round(batch_median / (batch_median + update_median), 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--target", default="IIWA-Inspire")
    parser.add_argument("--demonstrations", type=int, default=10)
    parser.add_argument("--results", type=Path, default=Path("results/training"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "converted"
        convert(root, args.target, args.demonstrations)
        fast = opened(root, FastReader)
        reading = {
            "lerobot": round(samples_per_s(opened(root, DatasetReader), 20), 1),
            "ours": round(samples_per_s(fast, 2000), 1),
        }
        print(f"samples a second: {reading}")
        policies = {}
        for name, options in POLICIES.items():
            policies[name] = training(fast, options, 8)
            print(f"{name}: {policies[name]}")
    result = {
        "target": args.target,
        "samples_per_s": reading,
        "batch": BATCH,
        "policies": policies,
    }
    save(args.results / "training.json", result, seeds=[0, args.demonstrations - 1])


if __name__ == "__main__":
    main()
