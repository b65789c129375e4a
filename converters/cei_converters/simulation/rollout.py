"""One episode in an environment, as a demonstration."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from cei_gym.demonstration import Demonstration

HOLD_STEPS = 20
"""Steps that the last target is held for a success to show."""


def record_episode(
    env, seed: int, index: int, variation: float = 1.0
) -> tuple[Demonstration, dict[str, Any], dict[str, Any]]:
    """One demonstration of the expert: the episode, its last `info`, and how the expert varied.

    Raises:
        CEIError: the environment has no expert.
    """
    expert = env.unwrapped.expert(seed, variation)

    def policy(observation: dict[str, np.ndarray]) -> Iterable[np.ndarray]:
        targets = expert.plan(observation["agent_pos"], observation["environment_state"]).astype(np.float32)
        return [*targets, *[targets[-1]] * HOLD_STEPS]

    frames, info = roll_out(env, seed, policy)
    return as_demonstration(env, frames, index), info, expert.describe()


def roll_out(
    env, seed: int, policy: Callable[[dict[str, np.ndarray]], Iterable[np.ndarray]]
) -> tuple[dict[str, list], dict[str, Any]]:
    """One episode, which ends with success, at the time limit, or with the actions.

    Args:
        policy: the first observation to actions (n,), absolute joint targets, rad or m.

    Returns:
        What was seen and done at each step, and the last `info`.
    """
    observation, info = env.reset(seed=seed)
    frames: dict[str, list] = {"qpos": [], "action": [], "cloud": [], "state": [], "depth": [], "rgb": []}
    for action in policy(observation):
        frames["qpos"].append(observation["agent_pos"])
        frames["action"].append(action)
        frames["cloud"].append(observation["point_cloud"])
        frames["state"].append(observation["environment_state"])
        frames["depth"].append(env.unwrapped.depth_m())
        frames["rgb"].append(env.unwrapped.rgb())
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
    return frames, info


def as_demonstration(env, frames: dict[str, list], index: int) -> Demonstration:
    """The frames of `roll_out` in this environment, at least one, as episode `index` of a dataset."""
    inner = env.unwrapped
    return Demonstration(
        embodiment=inner.embodiment.name,
        fps=env.metadata["render_fps"],
        qpos=np.array(frames["qpos"], float),
        action=np.array(frames["action"], float),
        scene=inner.scene,
        task=inner.task_text,
        depth_m={name: np.stack([images[name] for images in frames["depth"]]) for name in frames["depth"][0]},
        rgb={name: np.stack([images[name] for images in frames["rgb"]]) for name in frames["rgb"][0]},
        point_cloud_world=np.stack(frames["cloud"]),
        environment_state=np.array(frames["state"]),
        environment_state_names=inner.state_names,
        index=index,
    )
