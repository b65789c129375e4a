"""HDF5 files of robosuite's own demonstrations, made by robosuite with its own controller and laid out as robomimic lays them out."""

import json
from pathlib import Path
from typing import Any

import h5py
import mujoco
import numpy as np
import robosuite
from scipy.spatial.transform import Rotation

from cei_envs.experts import make_expert
from cei_envs.experts.plan import grip_pose
from cei_gym.embodiment import load_embodiment

ROBOT = "Panda-PandaGripper"
BODY = load_embodiment(ROBOT)
POSITION_M, TURN_RAD = 0.05, 0.5  # what an entry of 1 asks of robosuite's OSC_POSE
GAIN = 1.5  # its arm lags
HELD = 25  # frames at the end


def write(path: Path, task: str, seeds: range, **kwargs: Any) -> list[bool]:
    """Demonstrations of a task of robosuite's, and whether robosuite's own check found each done at its end."""
    env = robosuite.make(
        task,
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        ignore_done=True,
        **kwargs,
    )
    done = []
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        asked = {"robots": "Panda", "control_freq": 20, "use_camera_obs": False, **kwargs}
        data.attrs["env_args"] = json.dumps({"env_name": task, "type": 1, "env_kwargs": asked})
        for index, seed in enumerate(seeds):
            np.random.seed(seed)  # noqa: NPY002  (what robosuite draws from)
            env.reset()
            demo = data.create_group(f"demo_{index}")
            demo.attrs["model_file"] = env.sim.model.get_xml()
            frames = [*_played(env, task, seed)]
            for name in ("states", "actions"):
                demo[name] = np.array([frame[name] for frame in frames])
            for name in ("robot0_joint_pos", "robot0_gripper_qpos"):
                demo[f"obs/{name}"] = np.array([frame["obs"][name] for frame in frames])
            demo["obs/object"] = np.array([frame["obs"]["object-state"] for frame in frames])
            done.append(is_done(env))
    env.close()
    return done


def is_done(env: Any) -> bool:
    """What robosuite's own check says."""
    return bool(env._check_success())  # private: robosuite's check, which its reward alone uses


def model_of(env: Any) -> mujoco.MjModel:
    """The model of an environment of robosuite's."""
    return env.sim.model._model  # private: MuJoCo's own model, which robosuite wraps and gives no other name


def _played(env: Any, task: str, seed: int):
    """Frames of an episode in which robosuite's controller follows our expert's grip."""
    from cei_envs.tasks.stored_model import StoredModel

    T_world_base = np.eye(4)
    T_world_base[:3, 3] = env.sim.data.get_body_xpos("robot0_base")
    restores = _class_of(task)
    expert = make_expert(task, BODY, T_world_base, seed, **restores.expert_arguments)
    for _ in range(10):  # what robosuite drops comes to rest
        env.step(np.array([0.0] * 6 + [-1.0]))
    # private: robosuite's own way to its observations, which steps return before objects have come to rest
    observed = env._get_observations(force_update=True)
    stored = StoredModel(env.sim.model.get_xml())
    state = restores.stored_state(stored, env.sim.get_state().flatten()[None])[0]
    qpos = np.concatenate([observed["robot0_joint_pos"], observed["robot0_gripper_qpos"]])
    planned = expert.plan(qpos, state)
    for target in [*planned, *[planned[-1]] * HELD]:
        position, rotation = grip_pose(BODY, target)
        site = env.robots[0].eef_site_id["right"]
        here = env.sim.data.site_xpos[site] - T_world_base[:3, 3]
        turn = (rotation * Rotation.from_matrix(env.sim.data.site_xmat[site].reshape(3, 3)).inv()).as_rotvec()
        closing = 1.0 if target[7] < 0.5 * BODY.upper[7] else -1.0
        action = np.clip([*(GAIN * (position - here) / POSITION_M), *(GAIN * turn / TURN_RAD), closing], -1, 1)
        yield {"states": env.sim.get_state().flatten(), "actions": action, "obs": observed}
        env.step(action)
        # private: as above; what a step returns may be a sensor's period old
        observed = env._get_observations(force_update=True)


def _class_of(task: str) -> Any:
    from pkgutil import resolve_name

    from cei_envs.registration import tasks

    return resolve_name(tasks()[task].environment)
