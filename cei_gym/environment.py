"""What an environment offers beside Gymnasium's interface, for demonstrations to be recorded and replayed in it."""

from dataclasses import asdict, dataclass
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


@dataclass(frozen=True)
class PhysicsRule:
    """What a simulation does with its robot that no description says, or that one says otherwise.

    Attributes:
        part: name of the arm, the end-effector, or the embodiment if it is about both.
        kind: what it is about.
        source: by what it is so: a field of a YAML, an argument, a default; "off" if it is switched off.
        says: one sentence.
    """

    part: str
    kind: str
    source: str
    says: str


@dataclass(frozen=True)
class Physics:
    """How a simulation treats its robot.

    Attributes:
        rules: in the order in which people should read them.
        joints: a row of figures for each joint that it drives by rules of its own, as JSON types.
    """

    rules: tuple[PhysicsRule, ...] = ()
    joints: tuple[dict[str, Any], ...] = ()

    def record(self) -> dict[str, Any]:
        """As JSON types."""
        return {"rules": [asdict(rule) for rule in self.rules], "joints": list(self.joints)}


class RobotEnvironment(Protocol):
    """An environment of one embodiment. Observations have `agent_pos` (n,), rad or m, actions are absolute joint targets (n,), and
    `info` has `is_success` and, in one or two words, `failure`. Where steps may take other than `1 / render_fps`, `info` also has
    `step_time_s`, what the step took in the simulation, s, and the environment `longest_step_s`, the most that one takes.

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


@dataclass(frozen=True)
class Restored:
    """An episode that a simulator stored, as an environment of the same task has it.

    Attributes:
        environment_state: (T, k) as `state_names` of the environment names it.
        T_world_base: (4, 4) pose of the base of the robot that was recorded.
        surface_z_m: height in the world of what objects start on.
    """

    environment_state: Array
    T_world_base: Array
    surface_z_m: float


class Restores(Protocol):
    """An environment's class that takes up what the simulator under it stored, so that a converted file replays in the very task it came from.

    Attributes:
        state_names: as of `RobotEnvironment`.
    """

    state_names: tuple[str, ...]

    def restore(self, mjcf: str, states: Array) -> Restored:
        """An episode as stored.

        Args:
            mjcf: the model, as MJCF; a stranger's.
            states: (T, 1 + nq + nv) time, positions and speeds.

        Raises:
            CEIError: it is of another scene, or has not all of it.
        """
        ...


_NEEDED = ("embodiment", "scene", "task_text", "state_names", "channels", "expert")


def physics_of(env: gym.Env) -> Physics:
    """How the environment inside any wrappers treats its robot; nothing if it does not say so, by an attribute `physics`."""
    physics = getattr(env.unwrapped, "physics", None)
    return physics if isinstance(physics, Physics) else Physics()


def longest_step_s(env: gym.Env) -> float | None:
    """Most time of the simulation, s, that a step of the environment inside any wrappers takes; None if it does not say so."""
    longest = getattr(env.unwrapped, "longest_step_s", None)
    return None if longest is None else float(longest)


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
