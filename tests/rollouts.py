"""Environments of the catalogue, and what they are told."""

import gymnasium as gym
import numpy as np

from cei_envs import environment_id
from cei_envs.environment import CEIEnv


def make(task: str, name: str, **arguments) -> CEIEnv:
    """A task's environment, without Gymnasium's wrappers."""
    env = gym.make(environment_id(task, name), **arguments).unwrapped
    assert isinstance(env, CEIEnv)
    return env


def wander(env: CEIEnv, steps: int, seed: int = 0) -> np.ndarray:
    """(steps, n) targets near home."""
    rng, body = np.random.default_rng(seed), env.embodiment
    targets = body.home + np.cumsum(rng.uniform(-0.04, 0.04, (steps, len(body.home))), axis=0)
    return np.clip(targets, body.lower, body.upper).astype(np.float32)
