"""Lift: robosuite's own, for any robot."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from cei_envs.tasks.cube import TABLE_Z_M, cube_on_table
from cei_envs.tasks.of_robosuite import OfRobosuite, stored_cube
from cei_envs.tasks.pick_cube import HALF_SIZE_M, PickCubeEnv
from cei_envs.tasks.stored_model import StoredModel
from cei_gym.arrays import Array

PLACEMENT_M = 0.03
LIFTED_M = 0.04


class LiftEnv(PickCubeEnv, OfRobosuite):
    """robosuite's Lift: lift a cube off the table and hold it.

    robosuite's scene, cube, placement and check, where `PickCubeEnv` has the same scene with wider starts and a higher lift.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    As in `PickCubeEnv`, with the same `environment_state`, in which x and y start within 3 cm of the table's centre.

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): the centre of the cube has been more than 4 cm above
    the table (as in robosuite) for 20 control periods (1 s) in a row. `info["failure"]` says why not yet: never grasped, slipped, dropped,
    timed out. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws cube and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`.
    """

    task: ClassVar[str] = "Lift"
    task_text: ClassVar[str] = "Lift the cube."
    fixtures: ClassVar[Mapping[str, tuple[float, float, float]]] = {"table": (0.0, 0.0, 0.775)}
    surface_z_m: ClassVar[float] = TABLE_Z_M

    def sample_state(self, rng: np.random.Generator) -> Array:
        half = rng.uniform(*HALF_SIZE_M, 3)
        x, y = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2)
        return cube_on_table(x, y, rng.uniform(-np.pi, np.pi), half)

    def is_done(self) -> bool:
        self._highest = max(self._highest, self._lift_m)
        return self.cube.position_world[2] > TABLE_Z_M + LIFTED_M

    @classmethod
    def stored_state(cls, model: StoredModel, states: Array) -> Array:
        return stored_cube("cube", model, states)
