"""How pictures that are painted live, for the policy of another robot, differ from true ones: that robot's own simulation.

usage: python benchmarks/live_pictures.py [--tasks PickCube,StackCube,OpenDrawer] [--targets UR5e-FourierRight,...] [--seeds 2,3] [--results FOLDER]

The Panda's scripted expert drives the target through `CrossEmbodimentWrapper(impersonate=...)`, which paints the Panda over it. Shares are of pixels that are off by
more than 10 of 255: of the whole picture, painted and not, and of what is moved from when it has moved by 2 cm (not of the drawer). Seeds are those of
development, below 1000.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from compared import AWAY_M, OFF, SHOWN, SOURCE, WIDTH, arguments, decibels, parsed, similarity, size
from measure import save
from PIL import Image

import cei_gym  # noqa: F401  (registers the environments)
from cei_converters.simulation.rollout import HOLD_STEPS, record_episode
from cei_gym.embodiment import load_embodiment
from cei_gym.environment import robot_environment
from cei_gym.transfer import Transfer
from cei_gym.wrapper import CrossEmbodimentWrapper

FITTED_SEEDS = 0, 1
MOVED_M = 0.02
FIGURE, SHEET = "live.json", "live.png"


def play(task: str, target: str, seeds: list[int]) -> tuple[dict[str, Any], np.ndarray]:
    """The figures of a task and a target, and rows of pictures of the first seed: seen, painted, true."""
    own: Any = gym.make(f"CEI-{task}-{SOURCE}", pixels=True, **size(WIDTH))
    transfer = Transfer(load_embodiment(SOURCE), load_embodiment(target))
    transfer.fit([record_episode(own, seed, seed)[0] for seed in FITTED_SEEDS])
    env: Any = CrossEmbodimentWrapper(
        gym.make(f"CEI-{task}-{target}", pixels=True, colours=True, **size(WIDTH)), impersonate=transfer
    )
    parts: dict[str, list[np.ndarray]] = {"whole": [], "unpainted": [], "held": []}
    figures: dict[str, list[float]] = {"ssim": [], "psnr": []}
    rows, successes = [], 0
    for seed in seeds:
        strip = []
        observation, info = env.reset(seed=seed)
        began = observation["environment_state"][:3]
        plan = own.unwrapped.expert(seed).plan(observation["agent_pos"], observation["environment_state"])
        for action in [*plan, *[plan[-1]] * HOLD_STEPS]:
            qpos, state = observation["agent_pos"], observation["environment_state"]
            away = state.copy()
            away[1] += AWAY_M
            true, without = (
                own.reset(seed=0, options={"agent_pos": qpos, "environment_state": which})[0]["pixels"]["front"]
                for which in (state, away)
            )
            seen, shown = robot_environment(env).channels()["rgb"]["front"], observation["pixels"]["front"]
            wrong, left = (np.abs(each.astype(int) - true).max(axis=-1) > OFF for each in (shown, seen))
            parts["whole"].append(wrong.ravel())
            parts["unpainted"].append(left.ravel())
            if np.linalg.norm(state[:3] - began) > MOVED_M:
                parts["held"].append(wrong[(true != without).any(axis=-1)])
            figures["ssim"].append(similarity(shown, true))
            figures["psnr"].append(decibels(shown, true))
            strip.append((seen, shown, true))
            observation, *_, ended, truncated, info = env.step(action.astype(np.float32))
            if ended or truncated:
                break
        successes += info["is_success"]
        few = np.linspace(0, len(strip) - 1, SHOWN).round().astype(int)
        rows.append(np.concatenate([np.concatenate([strip[t][kind] for t in few], 1) for kind in range(3)]))
    env.close()
    own.close()
    shares = {name: float(np.concatenate(of).mean()) if of else None for name, of in parts.items()}
    means = {name: float(np.mean(of)) for name, of in figures.items()}
    return shares | means | {"episodes": len(seeds), "successes": int(successes)}, rows[0]


def main() -> None:
    parser = arguments(__doc__, "2,3")
    args, seeds = parsed(parser)
    table, sheet = [], []
    for task in args.tasks.split(","):
        for target in args.targets.split(","):
            figures, rows = play(task, target, seeds)
            table.append({"task": task, "target": target, **figures})
            print(task, target, {name: value and round(value, 4) for name, value in figures.items()}, flush=True)
            sheet += [rows] if target == args.targets.split(",")[0] else []
    if args.results is not None:
        args.results.mkdir(parents=True, exist_ok=True)
        picture = Image.fromarray(np.concatenate(sheet))
        picture.resize((picture.width // 2, picture.height // 2)).save(args.results / SHEET)
        save(
            args.results / FIGURE, {"table": table, "size": size(WIDTH), "off": OFF}, SHEET, seeds=[seeds[0], seeds[-1]]
        )


if __name__ == "__main__":
    main()
