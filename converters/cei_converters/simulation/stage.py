"""An environment as a stage: recorded actions are executed from recorded starts."""

from typing import TYPE_CHECKING, Any, Self

import numpy as np

from cei_converters.simulation.rollout import HOLD_STEPS, timed
from cei_gym.arrays import Array
from cei_gym.environment import Physics, physics_of
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.simulation.perturbation import Perturbation
    from cei_gym.demonstration import Demonstration


class Stage:
    """An environment that demonstrations replay in; a context manager that closes it.

    Nothing is rendered but what is filmed.

    Args:
        env_id: the environment.
        kwargs: for its constructor.

    Raises:
        CEIError: there is no such environment.
    """

    def __init__(self, env_id: str, **kwargs: Any) -> None:
        from cei_converters.simulation.environment import open_environment

        self.env_id = env_id
        self.stock_physics = bool(kwargs.get("stock_physics", False))
        self.env = open_environment(env_id, **(kwargs | {"clouds": False, "render_mode": "rgb_array"}))

    @property
    def embodiment(self) -> str:
        """Name of the robot in it."""
        return self.env.get_wrapper_attr("embodiment").name

    @property
    def n_arm(self) -> int:
        """How many joints the arm of the robot in it has."""
        return self.env.get_wrapper_attr("embodiment").n_arm

    @property
    def physics(self) -> Physics:
        """By which rules the simulation treats the robot."""
        return physics_of(self.env)

    def play(
        self, demonstration: "Demonstration", filmed: bool = False, perturbation: "Perturbation | None" = None
    ) -> tuple[dict[str, Any], list[Array]]:
        """Execute a demonstration's actions from its recorded start, the last one held for a success to show; perturbed, if that is given.

        Returns:
            The result (episode, success, failure, steps, frames, and what steps took), and a picture a step if filmed.

        Raises:
            CEIError: it is of another robot, or has no start.
        """
        if demonstration.embodiment != self.embodiment:
            raise CEIError(
                f"episode {demonstration.index} is of {demonstration.embodiment}, but {self.env_id} has a {self.embodiment}."
            )
        if demonstration.environment_state is None:
            raise CEIError(f"episode {demonstration.index} has no privileged.environment_state to start from.")
        env = self.env
        state, others = demonstration.environment_state[0], {}
        if perturbation is not None:
            names = env.get_wrapper_attr("state_names")
            demonstration, state = perturbation.moved(demonstration), perturbation.start(state, names)
            others = {"friction_scale": perturbation.friction_scale}
        start = {"environment_state": state, "agent_pos": demonstration.qpos[0], **others}
        _, info = env.reset(seed=demonstration.index, options=start)
        pictures: list[Any] = [env.render()] if filmed else []
        infos: list[dict[str, Any]] = []
        for action in [*demonstration.action, *[demonstration.action[-1]] * HOLD_STEPS]:
            _, _, terminated, truncated, info = env.step(action.astype(np.float32))
            infos.append(info)
            if filmed:
                pictures.append(env.render())
            if terminated or truncated:
                break
        entry = {
            "episode": demonstration.index,
            "success": bool(info["is_success"]),
            "failure": info["failure"],
            "steps": len(infos),
            "frames": len(demonstration),
            **timed(env, infos),
        }
        return entry, pictures

    def close(self) -> None:
        """Free the simulation."""
        self.env.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
