"""Impersonation: the Panda's scripted expert, unchanged, drives another robot through `CrossEmbodimentWrapper`.

usage: python benchmarks/impersonation.py [--task PickCube] [--target UR5e-FourierRight] [--seed 2000] [--episodes 20]

The transfer is fitted to demonstrations of seeds 0-5. Writes results/impersonation/<task>-<target>.json, with what a step of
`Transfer.stream` takes, contact carried over, on the same demonstrations.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, thread_time

import gymnasium as gym
import numpy as np
from measure import save
from tqdm import tqdm

import cei_gym  # noqa: F401  (registers the environments)
from cei_converters.simulation.rollout import HOLD_STEPS, record_episode
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer
from cei_gym.wrapper import CrossEmbodimentWrapper

SOURCE = "Panda-PandaGripper"
FITTED_SEEDS = range(6)


class Clock(gym.Wrapper):
    """Remembers how long steps took, s."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.seconds: list[float] = []

    def step(self, action):
        start = perf_counter()
        result = self.env.step(action)
        self.seconds.append(perf_counter() - start)
        return result


def percentiles(milliseconds: Sequence[float]) -> dict[str, float]:
    """The median and the 99th."""
    return {str(p): round(float(np.percentile(milliseconds, p)), 2) for p in (50, 99)}


def stream_ms(transfer: Transfer, demonstrations: list[Demonstration]) -> list[float]:
    """What each frame but the first takes of a core, ms."""
    live, took = transfer.stream(dt_s=1 / demonstrations[0].fps), []
    for demonstration in demonstrations:
        live.reset()
        for qpos, action in zip(demonstration.qpos, demonstration.action, strict=True):
            start = thread_time()
            live(qpos, action)
            took.append(1e3 * (thread_time() - start))
        took.pop(-len(demonstration))
    return took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--task", default="PickCube")
    parser.add_argument("--target", default="UR5e-FourierRight")
    parser.add_argument("--seed", type=int, default=2000)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--results", type=Path, default=Path("results/impersonation"))
    args = parser.parse_args()
    home = gym.make(f"CEI-{args.task}-{SOURCE}")
    transfer = Transfer(load_embodiment(SOURCE), load_embodiment(args.target))
    demonstrations = [record_episode(home, seed, i)[0] for i, seed in enumerate(tqdm(FITTED_SEEDS, "recording"))]
    transfer.fit(demonstrations)
    streamed_ms = stream_ms(transfer, demonstrations)
    inner = Clock(gym.make(f"CEI-{args.task}-{args.target}"))
    env = Clock(CrossEmbodimentWrapper(inner, impersonate=transfer))
    outcomes = []
    for seed in tqdm(range(args.seed, args.seed + args.episodes), "impersonating"):
        observation, _ = env.reset(seed=seed)
        # The expert of the Panda's own environment, which knows of no other robot.
        plan = home.unwrapped.expert(seed).plan(observation["agent_pos"], observation["environment_state"])
        for action in [*plan, *[plan[-1]] * HOLD_STEPS]:
            *_, terminated, truncated, info = env.step(action.astype(np.float32))
            if terminated or truncated:
                break
        outcomes.append(info["failure"] or "success")
    wrapper_ms = 1e3 * (np.array(env.seconds) - np.array(inner.seconds))
    result = {
        "task": args.task,
        "source": SOURCE,
        "target": args.target,
        "seeds": [args.seed, args.seed + args.episodes - 1],
        "fitted_seeds": [FITTED_SEEDS[0], FITTED_SEEDS[-1]],
        "episodes": args.episodes,
        "successes": outcomes.count("success"),
        "failures": dict(Counter(o for o in outcomes if o != "success")),
        "wrapper_ms": percentiles(wrapper_ms),
        "stream_ms": percentiles(streamed_ms),
    }
    save(args.results / f"{args.task}-{args.target}.json", result)
    print(
        f"{result['successes']} of {args.episodes} succeed; the wrapper takes {result['wrapper_ms']} ms (median, p99)"
    )


if __name__ == "__main__":
    main()
