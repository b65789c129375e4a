"""What an environment offers beside Gymnasium's interface, for demonstrations to be recorded and replayed in it."""

from typing import Any, Protocol, cast

import gymnasium as gym

from cei_gym.arrays import Array
from cei_gym.demonstration import Scene
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError


class Demonstrator(Protocol):
    """Who demonstrates a task by a script."""

    def plan(self, agent_pos: Array, environment_state: Array) -> Array:
        """(T, n) joint targets, rad or m, from joints (n,) and the state of objects (k,) at an episode's start."""
        ...

    def describe(self) -> dict[str, Any]:
        """How it varies, as JSON types."""
        ...


class RobotEnvironment(Protocol):
    """An environment of one embodiment. Observations have `agent_pos` (n,), rad or m, actions are absolute joint targets (n,), and
    `info` has `is_success` and, in one or two words, `failure`.

    Attributes:
        embodiment: the robot in it.
        scene: its base, cameras and workspace.
        task_text: the instruction in words.
        state_names: names with units of the entries of `environment_state`.
    """

    embodiment: Embodiment
    scene: Scene
    task_text: str
    state_names: tuple[str, ...]

    def channels(self) -> dict[str, Any]:
        """What demonstrations have of the moment of the last observation: channel of `Demonstration` to its values."""
        ...

    def expert(self, seed: int, variation: float = 1.0) -> Demonstrator:
        """Who demonstrates its task, varied by `seed`: 1 as people vary, 0 not at all.

        Raises:
            CEIError: there is none.
        """
        ...


_NEEDED = ("embodiment", "scene", "task_text", "state_names", "channels", "expert")


def robot_environment(env: gym.Env) -> RobotEnvironment:
    """The environment inside any wrappers, once it is known to offer all of that.

    Raises:
        CEIError: it lacks something; the message names it.
    """
    inner = env.unwrapped
    if lacking := [name for name in _NEEDED if not hasattr(inner, name)]:
        raise CEIError(
            f"{type(inner).__name__} has no {', '.join(lacking)}, which recording needs of an environment "
            "(cei_gym.environment.RobotEnvironment)."
        )
    return cast(RobotEnvironment, inner)
