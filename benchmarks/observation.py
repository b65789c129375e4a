"""Milliseconds of the steps of a synthesised observation: PickCube, an IIWA with an Inspire hand."""

from collections.abc import Callable
from functools import partial
from time import perf_counter

import gymnasium as gym
import numpy as np

import cei_gym  # noqa: F401  (registers the environments)
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import RobotMask, SurfaceSampler, crop, farthest_point_sample
from cei_gym.rendering import DepthCamera, camera_from_mujoco, unproject

WORKSPACE_WORLD = np.array([[-0.6, -0.5, 0.7], [0.4, 0.5, 1.6]])


def report(step: str, call: Callable, repeats: int = 20) -> object:
    """Prints median and least time of a call, after a first one that compiles; returns its result."""
    result, times_ms = call(), []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times_ms.append(1e3 * (perf_counter() - start))
    print(f"  {step:<34} {np.median(times_ms):7.2f} ms  (least {min(times_ms):.2f})")
    return result


def main() -> None:
    env = gym.make("CEI-PickCube-IIWA-Inspire")
    env.reset(seed=0)
    inner = env.unwrapped
    model, data, embodiment = inner.model, inner._simulation.data, inner.embodiment
    robot = [g for g in range(model.ngeom) if model.geom(g).name.startswith(("robot0", "gripper0"))]
    meshes = visual_link_meshes(embodiment.model)
    T_world_links = inner.scene.T_world_base @ KinematicTree(embodiment).forward(inner._simulation.qpos)

    start = perf_counter()
    mask = RobotMask(meshes)
    triangles = sum(len(mesh.faces) for mesh in meshes if mesh is not None)
    print(f"building the mask of {triangles} triangles: {perf_counter() - start:.2f} s (compiles when new)")
    sampler = SurfaceSampler(meshes, 2048)
    for width, height in ((160, 120), (320, 240)):
        print(f"{width}x{height}")
        camera = camera_from_mujoco(model, data, "sideview", width, height)
        depth_m, geom_id = report("depth and ids", partial(DepthCamera(model, [camera]).render, data))[camera.name]
        points_world = report("unproject", partial(unproject, depth_m, camera))
        inside = report(f"crop {len(points_world)}", partial(crop, points_world, WORKSPACE_WORLD))
        cropped = points_world[inside]
        on_robot = report(f"mask {len(cropped)}", partial(mask, cropped, T_world_links))
        true = np.isin(geom_id[depth_m > 0][inside], robot)
        print(f"    {on_robot.sum()} masked; {(true & ~on_robot).sum()} of the robot's {true.sum()} missed")
        added = report("sample 2048", partial(sampler, T_world_links))
        cloud = np.concatenate([cropped[~on_robot], added[crop(added, WORKSPACE_WORLD)]])
        report(f"thin {len(cloud)} to 1024", partial(farthest_point_sample, cloud))
    env.close()


if __name__ == "__main__":
    main()
