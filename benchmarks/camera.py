"""The depth camera against MuJoCo's own renderer, where a GL library exists: agreement and milliseconds a frame.

usage: python benchmarks/camera.py [--size 160x120] [--embodiment IIWA-Inspire] [--results results/observation]

Away from edges: pixels whose eight neighbours show the same geom, without a bend in depth. Writes camera.json.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
from measure import milliseconds, save, use_gl

import cei_gym  # noqa: F401  (registers the environments)
from cei_gym.rendering import DepthCamera, camera_from_mujoco

CAMERAS = ("agentview", "frontview", "sideview")
REPEATS = 30
SEEDS = 3
TASKS = ("OpenDrawer", "PickCube", "StackCube")


def away_from_edges(depth_m: np.ndarray, geom_id: np.ndarray) -> np.ndarray:
    """(H, W) bool."""
    inside = np.zeros(depth_m.shape, dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(depth_m, (3, 3))
    ids = np.lib.stride_tricks.sliding_window_view(geom_id, (3, 3))
    bend = np.abs(windows[..., 0, :] - 2 * windows[..., 1, :] + windows[..., 2, :]).max(axis=-1)
    bend += np.abs(windows[..., 0] - 2 * windows[..., 1] + windows[..., 2]).max(axis=-1)
    one_geom = (ids == ids[..., 1:2, 1:2]).all(axis=(-1, -2)) & (ids[..., 1, 1] >= 0)
    inside[1:-1, 1:-1] = one_geom & (bend < 0.02 * depth_m[1:-1, 1:-1])
    return inside


def compare(task: str, embodiment: str, width: int, height: int) -> dict:
    """One row."""
    env = gym.make(f"CEI-{task}-{embodiment}", clouds=False).unwrapped
    near, same, away, theirs_ms, ours_ms = [], [], [], [], []
    for seed in range(SEEDS):
        env.reset(seed=seed)
        model, data = env.model, env.simulation.data
        option = mujoco.MjvOption()
        option.geomgroup[:], option.sitegroup[:] = 0, 0
        option.geomgroup[1] = 1
        with mujoco.Renderer(model, height, width) as renderer:
            for name in CAMERAS:
                camera = camera_from_mujoco(model, data, name, width, height)
                ours = DepthCamera(model, [camera])

                def theirs(name: str = name) -> np.ndarray:
                    renderer.update_scene(data, name, option)  # noqa: B023  (called in this very turn)
                    return renderer.render()

                renderer.enable_segmentation_rendering()
                ids, kinds = np.moveaxis(theirs(), -1, 0)
                true_id = np.where(kinds == mujoco.mjtObj.mjOBJ_GEOM, ids, -1)
                renderer.disable_segmentation_rendering()
                renderer.enable_depth_rendering()
                true_depth_m = theirs().copy()
                depth_m, geom_id = ours.render(data)[name]
                inside = away_from_edges(true_depth_m, true_id)
                away.append(inside.mean())
                near.append((np.abs(depth_m - true_depth_m) < 1e-3)[inside])
                same.append((geom_id == true_id)[inside])
                if seed == 0:
                    theirs_ms.append(milliseconds(theirs, REPEATS)["median"])  # depth alone; ids are another pass
                    ours_ms.append(milliseconds(lambda: ours.render(data), REPEATS)["median"])  # noqa: B023
                renderer.disable_depth_rendering()
    env.close()
    return {
        "task": task,
        "within_1_mm_percent": round(100 * np.concatenate(near).mean(), 3),
        "same_geom_percent": round(100 * np.concatenate(same).mean(), 3),
        "away_from_edges_percent": round(100 * float(np.mean(away)), 1),
        "ours_ms": round(float(np.mean(ours_ms)), 2),
        "gl_ms": round(float(np.mean(theirs_ms)), 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="160x120")
    parser.add_argument("--embodiment", default="IIWA-Inspire")
    parser.add_argument("--results", type=Path, default=Path("results/observation"))
    args = parser.parse_args()
    width, height = map(int, args.size.split("x"))
    if not use_gl():
        raise SystemExit("MuJoCo's renderer does not run here: there is no GL library.")
    rows = []
    for task in TASKS:
        rows.append(compare(task, args.embodiment, width, height))
        print("  ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
    result = {
        "embodiment": args.embodiment,
        "size": args.size,
        "cameras": CAMERAS,
        "rows": rows,
    }
    save(args.results / "camera.json", result, seeds=[0, SEEDS - 1])


if __name__ == "__main__":
    main()
