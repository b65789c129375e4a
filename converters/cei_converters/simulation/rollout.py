"""One episode in an environment, as a demonstration."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from cei_converters.dataset.step_time import StepTimes
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.environment import longest_step_s, robot_environment

HOLD_STEPS = 20
"""Steps that the last target is held for a success to show."""


def record_episode(
    env: gym.Env, seed: int, index: int, variation: float = 1.0
) -> tuple[Demonstration, dict[str, Any], dict[str, Any]]:
    """One demonstration of the expert: the episode, its last `info`, and how the expert varied.

    Raises:
        CEIError: the environment has no expert, or is none of a robot.
    """
    expert = robot_environment(env).expert(seed, variation)

    def policy(observation: dict[str, Array]) -> Iterable[Array]:
        targets = expert.plan(observation["agent_pos"], observation["environment_state"]).astype(np.float32)
        return np.concatenate([targets, np.repeat(targets[-1:], HOLD_STEPS, axis=0)])

    frames, info = roll_out(env, seed, policy)
    return as_demonstration(env, frames, index), info, expert.describe()


def roll_out(
    env: gym.Env, seed: int, policy: Callable[[dict[str, Array]], Iterable[Array]]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """One episode, which ends with success, at the time limit, or with the actions.

    Args:
        policy: the first observation to actions (n,), absolute joint targets, rad or m.

    Returns:
        For each step the channels that a demonstration has of it, and the last `info`, with what each step took (`timed`).
    """
    channels = robot_environment(env).channels
    observation, info = env.reset(seed=seed)
    frames: list[dict[str, Any]] = []
    infos: list[dict[str, Any]] = []
    for action in policy(observation):
        frames.append({**channels(), "action": action})
        observation, _, terminated, truncated, info = env.step(action)
        infos.append(info)
        if terminated or truncated:
            break
    return frames, info | timed(env, infos)


def timed(env: gym.Env, infos: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What each step took in the simulation, by its `info`, as a field of an episode's record; nothing where the environment does not say."""
    each = [float(info["step_time_s"]) for info in infos if "step_time_s" in info]
    if not each or len(each) < len(infos):
        return {}
    return StepTimes(robot_environment(env).embodiment.name, each, longest_step_s(env)).record()


def as_demonstration(env: gym.Env, frames: Sequence[Mapping[str, Any]], index: int) -> Demonstration:
    """The frames of `roll_out` in this environment, at least one, as episode `index` of a dataset."""
    inner = robot_environment(env)
    return Demonstration(
        embodiment=inner.embodiment.name,
        fps=env.metadata["render_fps"],
        scene=inner.scene,
        task=inner.task_text,
        environment_state_names=inner.state_names,
        index=index,
        **{name: _stacked([frame[name] for frame in frames]) for name in frames[0]},
    )


def _stacked(values: Sequence[Any]) -> Any:
    """A channel's values of all frames; joints and states as numbers of double precision."""
    if isinstance(values[0], Mapping):
        return {name: np.stack([each[name] for each in values]) for name in values[0]}
    stacked = np.stack(values)
    return stacked.astype(float) if stacked.ndim == 2 else stacked
