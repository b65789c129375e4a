"""The depth camera against MuJoCo's own renderer, where a GL library exists: agreement and milliseconds a frame.

    MUJOCO_GL=egl python benchmarks/camera.py [--size 160x120]

Away from edges: pixels whose eight neighbours show the same geom, without a bend in depth.
"""

import argparse
from time import perf_counter

import gymnasium as gym
import mujoco
import numpy as np

import cei_gym  # noqa: F401  (registers the environments)
from cei_gym.rendering import DepthCamera, camera_from_mujoco

CAMERAS = ("agentview", "frontview", "sideview")
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


def milliseconds(call, repeats: int = 30) -> float:
    """Median time of a call after a first one."""
    call()
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times.append(1e3 * (perf_counter() - start))
    return float(np.median(times))


def compare(task: str, embodiment: str, width: int, height: int) -> None:
    """Prints one row."""
    env = gym.make(f"CEI-{task}-{embodiment}", clouds=False).unwrapped
    near, same, away, theirs_ms, ours_ms = [], [], [], [], []
    for seed in range(3):
        env.reset(seed=seed)
        model, data = env.model, env._simulation.data
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
                    theirs_ms.append(milliseconds(theirs))  # depth alone; ids are another pass
                    ours_ms.append(milliseconds(lambda: ours.render(data)))  # noqa: B023
                renderer.disable_depth_rendering()
    env.close()
    print(
        f"{task:<11} {100 * np.concatenate(near).mean():8.3f} {100 * np.concatenate(same).mean():8.3f} "
        f"{100 * np.mean(away):8.1f} {np.mean(ours_ms):8.2f} {np.mean(theirs_ms):8.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="160x120", help="of the images")
    parser.add_argument("--embodiment", default="IIWA-Inspire")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    print(f"{arguments.embodiment}, {width}x{height}, three viewpoints, three starts")
    print(f"{'task':<11} {'1 mm %':>8} {'ids %':>8} {'away %':>8} {'ours ms':>8} {'GL ms':>8}")
    for task in TASKS:
        compare(task, arguments.embodiment, width, height)


if __name__ == "__main__":
    main()
