"""Milliseconds of the steps of a synthesised observation: robosuite's Lift, an IIWA with an Inspire hand."""

from collections.abc import Callable
from functools import partial
from time import perf_counter

import mujoco
import numpy as np
import robosuite
import trimesh

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
    env = robosuite.make(
        "Lift",
        robots="IIWA",
        gripper_types="InspireRightHand",
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        hard_reset=False,
    )
    model, data = env.sim.model._model, env.sim.data._data
    robot = [
        g
        for g in range(model.ngeom)
        if model.geom_group[g] == 1 and model.geom(g).name.startswith(("robot0", "gripper0"))
    ]
    meshes = [geom_mesh(model, g) for g in robot]
    T_world_links = np.tile(np.eye(4), (len(robot), 1, 1))
    T_world_links[:, :3, :3] = data.geom_xmat[robot].reshape(-1, 3, 3)
    T_world_links[:, :3, 3] = data.geom_xpos[robot]

    start = perf_counter()
    mask = RobotMask(meshes)
    triangles = sum(len(mesh.faces) for mesh in meshes)
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


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """The mesh of a mesh geom, in its frame."""
    mesh = model.mesh(model.geom_dataid[geom])
    vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
    faces = model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]]
    return trimesh.Trimesh(vertices, faces, process=False)


if __name__ == "__main__":
    main()
