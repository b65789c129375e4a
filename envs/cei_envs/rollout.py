"""Environments as evaluation loops want them: augmented, one episode a reset, idle once it is over.

Imports nothing of LeRobot, so that the workers of a vector environment start in seconds.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym

import cei_gym  # noqa: F401  (registers the environments)
from cei_gym.pointcloud import CloudOptions
from cei_gym.wrapper import CrossEmbodimentWrapper

NEW_ROLLOUT = "lerobot_new_rollout"
"""Reset option by which LeRobot says that a new episode is wanted; resets without it are a vector environment's own."""


def make_rollout_env(env_id: str, augment: CloudOptions | None = None, paint: bool = False, **options: Any) -> gym.Env:
    """An environment for evaluation.

    Args:
        env_id: its id.
        augment: options of `CrossEmbodimentWrapper`'s clouds; None for clouds as cameras see them.
        paint: whether the robot is painted over itself in `pixels`, as in converted pictures.
        options: of `gym.make`.
    """
    env = gym.make(env_id, **options)
    return OneEpisode(env if augment is None else CrossEmbodimentWrapper(env, clouds=augment, paint=paint))


class OneEpisode(gym.Wrapper, gym.utils.RecordConstructorArgs, gym.utils.EzPickle):
    """After its end, an episode stands still: the last step is repeated, with no reward, until a new one is asked for.

    Vector environments step all their environments until the last is done; LeRobot looks at none past its end.
    """

    def __init__(self, env: gym.Env) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        gym.utils.EzPickle.__init__(self, env)
        gym.Wrapper.__init__(self, env)
        self._last: tuple | None = None

    @property
    def task_description(self) -> str:
        """The instruction in words."""
        return self.get_wrapper_attr("task_text")

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None):
        """A new episode; while one stands still only with the option `NEW_ROLLOUT`, which the environment does not see."""
        options = dict(options or {})
        asked = options.pop(NEW_ROLLOUT, False)
        if self._last is not None and not asked:
            return self._last[0], self._last[4]
        self._last = None
        return self.env.reset(seed=seed, options=options)

    def step(self, action):
        """As the environment's, until the episode's end."""
        if self._last is not None:
            return self._last
        observation, reward, terminated, truncated, info = self.env.step(action)
        if terminated or truncated:
            self._last = observation, 0.0, terminated, truncated, info
        return observation, reward, terminated, truncated, info
