"""Opening an environment by its id, with one clear line when that fails."""

from typing import Any

import gymnasium as gym

import cei_gym  # noqa: F401  (registers the environments)
from cei_gym.errors import CEIError, unknown

PREFIX = "CEI-"


def open_environment(env_id: str, **kwargs: Any) -> gym.Env:
    """`gym.make`, limited to ids of ours.

    Raises:
        CEIError: no such environment (the message lists the valid ones), or none is installed.
    """
    ids = [name for name in gym.registry if name.startswith(PREFIX)]
    if not ids:
        raise CEIError("no CEI environment is installed; pip install 'cei-gym[envs]'.")
    if env_id not in ids:
        raise unknown("environment", env_id, ids)
    return gym.make(env_id, **kwargs)
