"""Stack: robosuite's own, for any robot."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.of_robosuite import OfRobosuite, stored_cube
from cei_envs.tasks.stack_cube import StackCubeEnv
from cei_envs.tasks.stored_model import StoredModel
from cei_gym.arrays import Array


class StackEnv(StackCubeEnv, OfRobosuite):
    """robosuite's Stack: put the red cube on the green one and let go.

    robosuite's scene, cubes, placement and check; `StackCubeEnv` by the name that robosuite's files have. All of its page holds: spaces,
    `environment_state`, success (the cubes touch, the red one's centre is more than 4 cm above the table, and, where robosuite asks that the gripper
    does not grasp it, nothing of the robot touches it, for 1 s), start and arguments.
    """

    task: ClassVar[str] = "Stack"
    task_text: ClassVar[str] = "Stack the red cube on the green cube."
    fixtures: ClassVar[Mapping[str, tuple[float, float, float]]] = {"table": (0.0, 0.0, 0.775)}
    surface_z_m: ClassVar[float] = TABLE_Z_M

    @classmethod
    def stored_state(cls, model: StoredModel, states: Array) -> Array:
        return np.column_stack([stored_cube(name, model, states) for name in ("cubeA", "cubeB")])
