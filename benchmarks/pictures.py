"""How painted pictures differ from the true ones: the target's own simulation, with joints and objects as they are.

usage: python benchmarks/pictures.py [--tasks PickCube,StackCube,OpenDrawer] [--targets UR5e-FourierRight,...] [--seeds 0,1] [--width 320] [--results FOLDER]

The camera is known and the renderer the project's own. Shares are of pixels that are off by more than 10 of 255 in some channel. Parts of a picture: what the
source covered and the target does not; the target; what is carried, from when it is taken; the rest. Pictures as they pass through unpainted, which
show the source, stand beside. Seeds are those of development, below 1000.
"""

import time
from typing import Any

import numpy as np
from compared import AWAY_M, OFF, SHOWN, SOURCE, WIDTH, arguments, decibels, parsed, similarity, size
from measure import save
from PIL import Image

from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.rollout import record_episode
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.environment import robot_environment
from cei_gym.painting import Painter, Plate, Shot, carries
from cei_gym.painting.view import RobotView
from cei_gym.transfer import Transfer

LOOKED_AT = 8  # pictures of an episode, for what is behind the robot


def record(task: str, seeds: list[int], width: int) -> list[Demonstration]:
    env = open_environment(f"CEI-{task}-{SOURCE}", colours=True, **size(width))
    found = [record_episode(env, seed, seed)[0] for seed in seeds]
    env.close()
    return found


def true_pictures(env: Any, moved: Demonstration, frames: Array, states: Array) -> tuple[Array, Array]:
    """(T, H, W, 3) uint8 as the target's simulation shows them, and (T, H, W) bool, where they show the first object that can be moved away."""
    shown, without = [], []
    for qpos, state in zip(moved.qpos, states[frames], strict=True):
        away = state.copy()
        away[1] += AWAY_M  # y of the first object, but of a drawer, which has none
        for which, kept in ((state, shown), (away, without)):
            env.reset(seed=0, options={"agent_pos": qpos, "environment_state": which})
            kept.append(robot_environment(env).channels()["rgb"]["front"])
    pictures = np.stack(shown)
    return pictures, (pictures != np.stack(without)).any(axis=-1)


def measure(task: str, target: str, demonstrations: list[Demonstration], width: int) -> tuple[dict[str, Any], Array]:
    """The figures of a task and a target, and rows of pictures: recorded, painted, true."""
    source, body = load_embodiment(SOURCE), load_embodiment(target)
    transfer = Transfer(source, body)
    transfer.fit(demonstrations[:1])
    scene = demonstrations[0].scene
    base, camera = scene.T_world_base, scene.cameras[0]
    painter = Painter(source, body, base, base, camera)
    looked = [(d, t) for d in demonstrations for t in np.linspace(0, len(d) - 1, LOOKED_AT).round().astype(int)]
    samples = np.stack([d.rgb["front"][t] for d, t in looked])
    painter.plate = Plate.median(samples, painter.covered(np.stack([d.qpos[t] for d, t in looked])))
    views = [RobotView(robot, base, camera) for robot in (source, body)]
    env = open_environment(f"CEI-{task}-{target}", colours=True, **size(width))
    parts: dict[str, list[Array]] = {}
    figures: dict[str, list[float]] = {"ssim": [], "psnr": [], "psnr_robot": [], "ms": []}
    rows = np.empty(0)
    for demonstration in demonstrations:
        moved, _ = transfer(demonstration, clouds=False)
        frames = np.arange(len(moved)) if moved.source_frames is None else moved.source_frames
        states = demonstration.environment_state
        assert states is not None
        true, thing = true_pictures(env, moved, frames, states)
        before, held = demonstration.rgb["front"], carries(transfer.motion(demonstration), base)
        shot = Shot(before, demonstration.qpos, held)
        painter(shot, frames[:1], moved.qpos[:1])  # compiles
        begun = time.process_time()
        painted, _ = painter(shot, frames, moved.qpos)
        figures["ms"].append(1e3 * (time.process_time() - begun) / len(moved))
        was = np.stack([views[0].silhouette(q) for q in demonstration.qpos])[frames]
        is_ = np.stack([views[1].silhouette(q) for q in moved.qpos])
        wrong, left = (np.abs(each.astype(int) - true).max(axis=-1) > OFF for each in (painted, before[frames]))
        since = min((each.taken for each in held), default=len(before))
        thing &= (frames > since)[:, None, None]
        old = was & ~is_ & wrong & (np.abs(painted.astype(int) - before[frames]).max(axis=-1) <= 2)
        for name, part in {
            "whole": wrong,
            "uncovered": wrong[was & ~is_],
            "robot": wrong[is_],
            "held": wrong[thing],
            "rest": wrong[~was & ~is_],
            "unpainted": left,
            "old_robot_left": old[was & ~is_],
        }.items():
            parts.setdefault(name, []).append(part.ravel())
        figures["ssim"] += [similarity(a, b) for a, b in zip(painted, true, strict=True)]
        figures["psnr"].append(decibels(painted, true))
        figures["psnr_robot"].append(decibels(painted[is_], true[is_]))
        chosen = np.linspace(0, len(moved) - 1, SHOWN).round().astype(int)
        rows = np.concatenate(
            [np.concatenate([each[t] for t in chosen], 1) for each in (before[frames], painted, true)]
        )
    env.close()
    shares = {
        name: float(joined.mean()) if len(joined := np.concatenate(each)) else None for name, each in parts.items()
    }
    return shares | {name: float(np.mean(each)) for name, each in figures.items()}, rows


def main() -> None:
    parser = arguments(__doc__, "0,1")
    parser.add_argument("--width", type=int, default=WIDTH, help="of pictures, which are three quarters as high")
    args, seeds = parsed(parser)
    table, sheet = [], []
    for task in args.tasks.split(","):
        demonstrations = record(task, seeds, args.width)
        for target in args.targets.split(","):
            figures, rows = measure(task, target, demonstrations, args.width)
            table.append({"task": task, "target": target, **figures})
            print(task, target, {name: value and round(value, 4) for name, value in figures.items()}, flush=True)
            sheet += [rows] if target == args.targets.split(",")[0] else []
    if args.results is not None:
        args.results.mkdir(parents=True, exist_ok=True)
        picture, ending = Image.fromarray(np.concatenate(sheet)), "" if args.width == WIDTH else f"_{args.width}"
        names = [f"pictures{ending}.{kind}" for kind in ("json", "png")]
        picture.thumbnail((WIDTH * SHOWN // 2, picture.height))
        picture.save(args.results / names[1])
        result = {"table": table, "size": size(args.width), "off": OFF}
        save(args.results / names[0], result, names[1], seeds=[seeds[0], seeds[-1]])


if __name__ == "__main__":
    main()
