"""Milliseconds of a synthesised observation, ours and the obvious way, in one run on one core.

usage: python benchmarks/observation.py [--embodiment IIWA-Inspire] [--repeats 100] [--results results/observation]

PickCube, at the start of seed 0, in two views: the task's own camera and workspace, and, harder, a close-up with most of the robot
in a large workspace. The obvious way: MuJoCo's renderer (where there is a GL library), numpy for unprojecting and
cropping, `cdist` to points sampled on the robot for the mask (the paper's words), and plain farthest-point sampling. How many of
the robot's own points each mask misses is by the camera's exact segmentation. Writes observation.json.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one core for both ways

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
from measure import milliseconds, save, use_gl
from rich.console import Console
from rich.table import Table
from scipy.spatial.distance import cdist

import cei_gym  # noqa: F401  (registers the environments)
from cei_gym.demonstration import Camera
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import (
    CloudOptions,
    CloudSynthesiser,
    RobotMask,
    SurfaceSampler,
    crop,
    farthest_point_sample,
    fuse_depth,
)
from cei_gym.rendering import DepthCamera, camera_from_mujoco
from cei_gym.wrapper import CrossEmbodimentWrapper

SIZES = ((80, 60), (160, 120))
VIEWS = ("task", "close-up")
CLOSE_UP = "sideview"  # robosuite's camera
LARGE_WORLD = np.array([[-0.6, -0.5, 0.7], [0.4, 0.5, 1.6]])
OBVIOUS_SAMPLES = 4096


def gl_depth(model: mujoco.MjModel, data: mujoco.MjData, camera: Camera) -> Callable | None:
    """MuJoCo's own renderer; None where there is no GL library."""
    if not use_gl():
        return None
    renderer = mujoco.Renderer(model, camera.height, camera.width)
    renderer.enable_depth_rendering()
    option = mujoco.MjvOption()
    option.geomgroup[:] = np.arange(len(option.geomgroup)) == 1

    eye, forward = camera.T_world_camera[:3, 3], camera.T_world_camera[:3, 2]
    view = mujoco.MjvCamera()
    view.lookat, view.distance = eye + forward, 1.0
    view.azimuth, view.elevation = np.rad2deg([np.arctan2(forward[1], forward[0]), np.arcsin(forward[2])])
    model.vis.global_.fovy = np.rad2deg(2 * np.arctan(camera.height / 2 / camera.K[1, 1]))

    def render() -> np.ndarray:
        renderer.update_scene(data, view, option)
        return renderer.render()

    return render


def resized(camera: Camera, width: int) -> Camera:
    """The same view with other pixels, whose centres are at whole numbers."""
    factor = width / camera.width
    K = camera.K * factor
    K[:2, 2] = (camera.K[:2, 2] + 0.5) * factor - 0.5
    K[2, 2] = 1.0
    return replace(camera, width=width, height=round(camera.height * factor), K=K)


def obvious_unproject(depth_m: np.ndarray, camera: Camera) -> np.ndarray:
    v, u = np.indices(depth_m.shape)
    K, T = camera.K, camera.T_world_camera
    points = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], -1) * depth_m[..., None]
    return points.reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]


def measure(env: gym.Env, view: str, width: int, height: int, repeats: int) -> list[dict]:
    inner = env.unwrapped
    model, data, embodiment, scene = inner.model, inner.simulation.data, inner.embodiment, inner.scene
    robot = [g for g in range(model.ngeom) if model.geom(g).name.startswith(("robot0", "gripper0"))]
    meshes = visual_link_meshes(embodiment.model)
    tree = KinematicTree(embodiment)
    qpos = inner.simulation.qpos
    T_world_links = scene.T_world_base @ tree.forward(qpos)
    if view == "close-up":
        camera = camera_from_mujoco(model, data, CLOSE_UP, width, height)
        scene = replace(scene, cameras=(camera,), workspace_world=LARGE_WORLD)
    else:
        camera = resized(scene.cameras[0], width)
        scene = replace(scene, cameras=(camera,))
    box = scene.workspace_world
    ours = DepthCamera(model, [camera])
    gl = gl_depth(model, data, camera)
    depth_m, geom_id = ours.render(data)[camera.name]
    if gl is not None:
        assert np.median(np.abs(gl() - depth_m)[depth_m > 0]) < 1e-3  # they look at the same thing
    points = fuse_depth(scene, {camera.name: depth_m})
    inside = crop(points, box)
    cropped = points[inside]
    on_robot = np.isin(geom_id[depth_m > 0][inside], robot)
    mask, sampler = RobotMask(meshes), SurfaceSampler(meshes, CloudOptions().robot_points)
    samples = SurfaceSampler(meshes, OBVIOUS_SAMPLES)
    plain, voxels = (CloudSynthesiser(embodiment, embodiment, CloudOptions(voxel_m=v)) for v in (0.0, 0.01))
    ours_masked = mask(cropped, T_world_links)
    added = sampler(T_world_links)
    robot_points = added[crop(added, box)][:2048]  # as many as `CloudSynthesiser` takes
    cloud = np.concatenate([cropped[~ours_masked], robot_points]).astype(np.float32)

    def obvious_crop() -> np.ndarray:
        return ((points >= box[0]) & (points <= box[1])).all(axis=1)

    def obvious_mask() -> np.ndarray:
        return cdist(cropped, samples(T_world_links)).min(axis=1) < 0.005

    def obvious_sample() -> np.ndarray:
        poses = T_world_links[sampler.link_ids]
        return np.einsum("nij,nj->ni", poses[:, :3, :3], sampler.points_link) + poses[:, :3, 3]

    def obvious_thin(some: np.ndarray) -> np.ndarray:
        chosen, gap = [0], np.full(len(some), np.inf)
        while len(chosen) < 1024:
            away = some - some[chosen[-1]]
            gap = np.minimum(gap, np.einsum("ni,ni->n", away, away))
            chosen.append(int(gap.argmax()))
        return some[chosen]

    def whole(by: CloudSynthesiser) -> np.ndarray:
        return by.add(by.remove(fuse_depth(scene, {camera.name: depth_m}), scene, qpos), scene, qpos)

    def obvious_whole() -> np.ndarray:
        obvious_unproject(depth_m, camera)
        kept = points[obvious_crop()][~obvious_mask()]
        robot = obvious_sample()
        robot = robot[((robot >= box[0]) & (robot <= box[1])).all(axis=1)]
        return obvious_thin(np.concatenate([kept, robot]).astype(np.float32))

    steps = {
        "camera": (lambda: ours.render(data), gl),
        "unproject": (lambda: fuse_depth(scene, {camera.name: depth_m}), lambda: obvious_unproject(depth_m, camera)),
        "crop": (lambda: crop(points, box), obvious_crop),
        "mask": (lambda: mask(cropped, T_world_links), obvious_mask),
        "sample": (lambda: sampler(T_world_links), obvious_sample),
        "thin": (lambda: farthest_point_sample(cloud), lambda: obvious_thin(cloud)),
        "whole": (lambda: whole(plain), obvious_whole),
        "whole, voxel_m=0.01": (lambda: whole(voxels), None),
    }
    missed = {"ours": int((on_robot & ~ours_masked).sum()), "obvious": int((on_robot & ~obvious_mask()).sum())}
    rows = []
    for step, (mine, obvious) in steps.items():
        row = {"view": view, "points": width * height, "step": step, "ours_ms": milliseconds(mine, repeats)}
        row["obvious_ms"] = None if obvious is None else milliseconds(obvious, max(3, repeats // 10))
        if step == "mask":
            row |= {"in_the_crop": len(cropped), "on_the_robot": int(on_robot.sum()), "missed": missed}
        if step == "thin":
            row |= {"from": len(cloud)}
        rows.append(row)
    return rows


def measure_steps(name: str, steps: int) -> dict[str, dict[str, float]]:
    """A control period of PickCube (1/20 s), as it is and through the wrapper, each with its observation."""
    result = {}
    for what in ("environment", "with CrossEmbodimentWrapper"):
        env = gym.make(f"CEI-PickCube-{name}", max_hold_ticks=1)
        if what != "environment":
            env = CrossEmbodimentWrapper(env)
        env.reset(seed=0)
        qpos, rng = env.unwrapped.embodiment.home.astype(np.float32), np.random.default_rng(0)
        result[what] = milliseconds(lambda: env.step(qpos + rng.normal(0, 0.02, qpos.shape)), steps)  # noqa: B023
        env.close()
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--embodiment", default="IIWA-Inspire")
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--results", type=Path, default=Path("results/observation"))
    args = parser.parse_args()
    env = gym.make(f"CEI-PickCube-{args.embodiment}")
    env.reset(seed=0)
    rows = [row for view in VIEWS for size in SIZES for row in measure(env, view, *size, args.repeats)]
    env.close()
    table = Table("view", "points", "step", "ours, ms", "p99", "the obvious way, ms", "robot's points missed")
    for row in rows:
        obvious = "" if row["obvious_ms"] is None else str(row["obvious_ms"]["median"])
        missed = (
            "{ours} and {obvious} of {of}".format(**row["missed"], of=row["on_the_robot"]) if "missed" in row else ""
        )
        ours = row["ours_ms"]
        table.add_row(
            row["view"], str(row["points"]), row["step"], str(ours["median"]), str(ours["p99"]), obvious, missed
        )
    Console(width=120).print(table)
    periods = measure_steps(args.embodiment, args.repeats)
    for what, ms in periods.items():
        print(f"a control period of 50 ms, {what}: {ms['median']} ms (p99 {ms['p99']})")
    result = {
        "embodiment": args.embodiment,
        "repeats": args.repeats,
        "rows": rows,
        "control_period_ms": periods,
    }
    save(args.results / "observation.json", result, seeds=[0, 0])


if __name__ == "__main__":
    main()
