"""Files of a simulator's own demonstrations: which environment of ours is that very task, and what it makes of what was stored."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import h5py
import numpy as np
from gymnasium.envs.registration import load_env_creator

import cei_gym
from cei_converters.dataset.metadata import Environment
from cei_converters.sources import hdf5
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.environment import Restored, Restores
from cei_gym.errors import CEIError

MODEL, STATES = "model_file", "states"
"""An episode's attribute with its model, as MJCF, and its dataset of time, positions and speeds, as robosuite and robomimic name them."""
THE_SIMULATORS = "the simulator's, the source robot in it"
"""Why states are left out, if nothing else is known of them."""
_SAME = 1e-3


@dataclass(frozen=True)
class SimulatedTask:
    """An environment that restores what a file's simulator stored.

    Attributes:
        environment: its id, of the recorded robot.
        restores: its class.
    """

    environment: Environment
    restores: Restores

    @property
    def state_names(self) -> tuple[str, ...]:
        """Of what it restores."""
        return self.restores.state_names

    def restored(self, episode: h5py.Group, frames: int, where: str, root: Path) -> Restored:
        """What an episode of so many frames is there.

        Raises:
            CEIError: it lacks what the first episode has, or is of another scene.
        """
        states = hdf5.dataset_at(episode, STATES, root)
        mjcf = _model(episode)
        if states is None or mjcf is None:
            raise CEIError(
                f"{where} lacks {STATES if states is None else MODEL}, which the first episode has; leave it out with --episodes."
            )
        values = hdf5.read(states, root)
        if len(values) != frames:
            raise CEIError(
                f"{where} has {len(values)} rows of {STATES} but {frames} frames; leave it out with --episodes."
            )
        try:
            return self.restores.restore(mjcf, values)
        except CEIError as error:
            raise CEIError(f"{where}: {error}") from error


def simulated_task(env_args: Mapping[str, Any], embodiment: Embodiment, episode: h5py.Group) -> SimulatedTask | str:
    """The environment of the task that a file's `env_args` name, for its robot; or why there is none.

    Args:
        env_args: the file's.
        embodiment: the recorded robot.
        episode: the first.
    """
    name = env_args.get("env_name")
    env_id = f"CEI-{name}-{embodiment.name}"
    if env_id not in gym.registry:
        cei_gym.register_environments()
    spec = gym.registry.get(env_id)
    if spec is None or spec.entry_point is None:
        return THE_SIMULATORS
    made_by = spec.entry_point if callable(spec.entry_point) else load_env_creator(spec.entry_point)
    if not hasattr(made_by, "restore"):
        return THE_SIMULATORS
    if _model(episode) is None:
        return f"{THE_SIMULATORS}, and without {MODEL} nobody knows what is where"
    return SimulatedTask(Environment(env_id), cast("Restores", made_by))


def same_place(T_world_base: Array, other: Array) -> bool:
    """Whether two poses of a base (4, 4) are one."""
    return bool(np.allclose(T_world_base, other, atol=_SAME))


def _model(episode: h5py.Group) -> str | None:
    text = episode.attrs.get(MODEL)
    text = text.decode(errors="replace") if isinstance(text, bytes) else text
    return text if isinstance(text, str) else None
