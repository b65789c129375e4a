"""How near to the truth a camera is found from joints and pictures, from guesses that are off.

usage: python benchmarks/camera_fit.py [--task PickCube] [--starts 20] [--far 0.03,3,0.05] [--results FOLDER]

Pictures are the project's own renderer's, 320 x 240, 18 of three demonstrations of development seeds. The guess of start i is off by so many metres and degrees
in directions drawn with seed i, and by so much of the focal length, more or less. Errors are distances in pixels between where the camera
that was found and the true one see the surface of the robot, in the mean over it and all pictures.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from measure import save
from scipy.spatial.transform import Rotation

from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.rollout import record_episode
from cei_gym.demonstration import Camera
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.painting import fit_camera
from cei_gym.painting.view import RobotView
from cei_gym.rendering import image_points, unproject

SOURCE, SEEDS, EACH = "Panda-PandaGripper", (0, 1, 2), 6
FIGURE = "camera_fit.json"


def guessed(camera: Camera, seed: int, far_m: float, far_deg: float, focal: float) -> Camera:
    random = np.random.default_rng(seed)
    axis, shift = (each / np.linalg.norm(each) for each in random.normal(size=(2, 3)))
    T, K = camera.T_world_camera.copy(), camera.K.copy()
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(np.radians(far_deg) * axis).as_matrix()
    T[:3, 3] += far_m * shift
    K[[0, 1], [0, 1]] *= 1 + random.choice([-focal, focal])
    return replace(camera, T_world_camera=T, K=K)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="PickCube")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--far", default="0.03,3,0.05")
    parser.add_argument("--results", type=Path)
    args = parser.parse_args()
    far_m, far_deg, focal = map(float, args.far.split(","))
    env = open_environment(f"CEI-{args.task}-{SOURCE}", colours=True, image_width=320, image_height=240)
    shown, joints, scene = [], [], None
    for seed in SEEDS:
        demonstration, _, _ = record_episode(env, seed, seed)
        few = np.linspace(0, len(demonstration) - 1, EACH).round().astype(int)
        shown.append(demonstration.rgb["front"][few])
        joints.append(demonstration.qpos[few])
        scene = demonstration.scene
    env.close()
    assert scene is not None
    pictures, qpos, true = np.concatenate(shown), np.concatenate(joints), scene.cameras[0]
    robot = load_embodiment(SOURCE)
    view = RobotView(robot, scene.T_world_base, true)
    surface = []
    for q in qpos:
        drawn = view.draw(q)
        surface.append(unproject(drawn.depth_m, drawn.camera))
    points, rows = np.concatenate(surface), []
    seen, _ = image_points(points, true)
    for start in range(args.starts):
        guess = guessed(true, start, far_m, far_deg, focal)
        began = float(np.linalg.norm(image_points(points, guess)[0] - seen, axis=1).mean())
        row = {"start": start, "began_px": began}
        cpu, wall = time.process_time(), time.perf_counter()
        try:
            found = fit_camera(robot, scene.T_world_base, guess, pictures, qpos)
            off = np.linalg.norm(image_points(points, found.camera)[0] - seen, axis=1)
            row |= {"off_px": float(off.mean()), "off_most_px": float(off.max()), "said_px": found.apart_px}
        except CEIError as error:
            row["refused"] = str(error)
        row |= {"cpu_s": time.process_time() - cpu, "wall_s": time.perf_counter() - wall}
        print({name: round(value, 2) if isinstance(value, float) else value for name, value in row.items()}, flush=True)
        rows.append(row)
    found_px = [row["off_px"] for row in rows if "off_px" in row]
    within = sum(off <= 1 for off in found_px)
    print(f"{within} of {len(rows)} within 1 pixel, {len(rows) - len(found_px)} refused")
    if args.results is not None:
        args.results.mkdir(parents=True, exist_ok=True)
        result = {"rows": rows, "within_1_px": within, "far": args.far, "task": args.task}
        save(args.results / FIGURE, result, seeds=[SEEDS[0], SEEDS[-1]])


if __name__ == "__main__":
    main()
