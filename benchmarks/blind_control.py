"""Blind control: each recorded demonstration replayed from another's start. It must fail, or success says nothing.

usage: python benchmarks/blind_control.py [--seed 2000] [--episodes 20] [--results results/replay]

It stands beside the cells of `cei-benchmark replay`, so its seeds must be theirs.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from measure import save

import cei_gym  # noqa: F401  (registers the environments)
from cei_converters.benchmark.figures import Manifest
from cei_converters.simulation.rollout import HOLD_STEPS

ENVIRONMENT = "CEI-PickCube-Panda-PandaGripper"


def check_seeds(folder: Path, first: int, last: int) -> None:
    """Check that the folder's cells, if there are any, have these seeds.

    Raises:
        SystemExit: they have others.
    """
    for figure in Manifest.read(folder).figures:
        seeds = figure.seeds if figure.command.startswith("cei-benchmark replay") else None
        if seeds is not None and not seeds[0] <= first <= last <= seeds[1]:
            raise SystemExit(
                f"{folder} has cells of seeds {seeds[0]}-{seeds[1]}, not {first}-{last}; choose other --results."
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=2000)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--results", type=Path, default=Path("results/replay"))
    args = parser.parse_args()
    check_seeds(args.results, args.seed, args.seed + args.episodes - 1)
    env = gym.make(ENVIRONMENT)
    seeds = range(args.seed, args.seed + args.episodes)
    demonstrations = []
    for seed in seeds:
        start, _ = env.reset(seed=seed)
        targets = env.unwrapped.expert(seed).plan(start["agent_pos"], start["environment_state"])
        demonstrations.append((start, targets.astype(np.float32)))
    successes = 0
    for i, (start, _) in enumerate(demonstrations):
        _, targets = demonstrations[(i + 1) % len(demonstrations)]
        env.reset(options={key: start[key] for key in ("agent_pos", "environment_state")})
        for action in [*targets, *[targets[-1]] * HOLD_STEPS]:
            *_, terminated, _, info = env.step(action)
            if terminated:
                break
        successes += info["is_success"]
    result = {"env": ENVIRONMENT, "seeds": [seeds[0], seeds[-1]], "episodes": len(seeds), "successes": int(successes)}
    save(args.results / "blind_control.json", result)
    print(f"blind control: {successes} of {len(seeds)} succeed")


if __name__ == "__main__":
    main()
