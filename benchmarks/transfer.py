"""The paper's time table: 100 to 400 demonstrations of 105 frames, from one robot's dataset to another's.

usage: python benchmarks/transfer.py [--target IIWA-Inspire] [--demonstrations 100 200 300 400] [--results DIR]

Ten recorded demonstrations of PickCube (seeds 0-9, depth images), brought to 105 frames, are repeated to make a dataset.
`cei-convert` then runs in a process of its own for each number of demonstrations, start-up and choice of the start included.
What its steps take is measured apart, one after the other on one core. Writes transfer.json.
"""

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import gymnasium as gym
import numpy as np
import psutil
from measure import save
from tqdm import tqdm

import cei_gym  # noqa: F401  (registers the environments)
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.simulation.rollout import record_episode
from cei_converters.sources.reader import DatasetReader
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer

SOURCE = "Panda-PandaGripper"
FRAMES = 105
PAPER_S = {100: 150, 200: 174, 300: 198, 400: 216}
"""The paper's table: minutes on an RTX 4090, as s."""


def record(seeds: range) -> list[Demonstration]:
    env = gym.make(f"CEI-PickCube-{SOURCE}")
    recorded = [record_episode(env, seed, seed)[0] for seed in tqdm(seeds, "recording")]
    return [d.at(np.linspace(0, len(d) - 1, FRAMES).round().astype(int)) for d in recorded]


def write(root: Path, demonstrations: list[Demonstration], count: int) -> None:
    with DatasetWriter("benchmark/source", root) as writer:
        for i in tqdm(range(count), "writing the source dataset"):
            writer.add(demonstrations[i % len(demonstrations)])


def convert(root: Path, target: str, count: int, *more: str) -> dict:
    """A conversion in a process of its own, with more options maybe."""
    new_root = root.with_name(f"converted_{count}")
    command = [sys.executable, "-m", "cei_converters.convert", "--dataset.repo_id=benchmark/source"]
    command += [f"--dataset.root={root}", f"--target={target}", "--new_repo_id=benchmark/converted"]
    command += [f"--new_root={new_root}", f"--episodes=0-{count - 1}", *more]
    start = perf_counter()
    process = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    cpu_s, memory = watch(process)
    seconds = perf_counter() - start
    if process.returncode != 0:
        raise SystemExit(process.stderr.read().decode() if process.stderr else "cei-convert failed")
    return {
        "demonstrations": count,
        "whole_s": round(seconds, 1),
        "cpu_s": round(cpu_s, 1),
        "peak_memory_mb": round(memory / 2**20),
        "paper_s": PAPER_S.get(count),
    }


def watch(process: psutil.Popen) -> tuple[float, int]:
    """CPU seconds of a process and all it started, and the most memory that they had together, bytes, shared pages once."""
    cpu_s, most = {}, 0
    while process.poll() is None:
        memory = 0
        with contextlib.suppress(psutil.NoSuchProcess):
            for one in (process, *process.children(recursive=True)):
                with contextlib.suppress(psutil.NoSuchProcess, psutil.AccessDenied, psutil.ZombieProcess):
                    cpu_s[one.pid, one.create_time()] = sum(one.cpu_times()[:2])
                    memory += one.memory_full_info().pss
        most = max(most, memory)
        time.sleep(0.5)
    return sum(cpu_s.values()), most


class Stopwatch:
    """Adds up what named steps take, s."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, step: str):
        start = perf_counter()
        yield
        self.seconds[step] = self.seconds.get(step, 0.0) + perf_counter() - start

    def timed(self, step: str, call):
        def timed(*args):
            with self(step):
                return call(*args)

        return timed


def steps(root: Path, target: str, count: int) -> dict[str, float]:
    """Milliseconds of each step a demonstration, on one core."""
    reader = DatasetReader("benchmark/source", root)
    transfer, watch = Transfer(reader.embodiment, load_embodiment(target)), Stopwatch()
    transfer.fit([reader.read(i) for i in range(min(8, len(reader)))])
    transfer(reader.read(0))  # compiles
    synthesiser = transfer.synthesiser
    synthesiser.remove = watch.timed("remove the source", synthesiser.remove)
    synthesiser.add = watch.timed("add the target, thin", synthesiser.add)
    with DatasetWriter("benchmark/steps", root.with_name("steps")) as writer:
        for i in tqdm(range(count), "steps"):
            with watch("read"):
                demonstration = reader.read(i)
            with watch("transfer"):
                moved, _ = transfer(demonstration)
            with watch("write"):
                writer.add(moved)
    seconds = watch.seconds
    seconds["align"] = seconds.pop("transfer") - seconds["remove the source"] - seconds["add the target, thin"]
    order = ("read", "remove the source", "align", "add the target, thin", "write")
    return {step: round(1e3 * seconds[step] / count, 1) for step in order}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--target", default="IIWA-Inspire")
    parser.add_argument("--demonstrations", type=int, nargs="+", default=[100, 200, 300, 400])
    parser.add_argument("--results", type=Path, default=Path("results/transfer"))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "source"
        most = max(args.demonstrations)
        write(root, record(range(min(10, most))), most)
        each = steps(root, args.target, min(20, *args.demonstrations))
        print("ms a demonstration on one core: " + ", ".join(f"{step} {ms}" for step, ms in each.items()))
        rows = []
        for count in args.demonstrations:
            rows.append(convert(root, args.target, count))
            print("  ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    result = {
        "source": SOURCE,
        "target": args.target,
        "frames": FRAMES,
        "cores": os.cpu_count(),
        "ms_a_demonstration_on_one_core": each,
        "conversions": rows,
    }
    save(args.results / "transfer.json", result, seeds=[0, min(10, most) - 1])


if __name__ == "__main__":
    main()
