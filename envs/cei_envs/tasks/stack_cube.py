"""StackCube: put one cube on another and let go."""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from cei_envs.environment import CEIEnv
from cei_envs.tasks.cube import STATE_SIZE, TABLE_Z_M, Cube, cube_on_table, state_names
from cei_gym.arrays import Array

PLACEMENT_M = 0.08
HALF_SIZES_M = (0.020, 0.025)
APART_M = 0.065
LIFTED_M = 0.04
OFF_TABLE_M = 0.01
PUSHED_M = 0.02


class StackCubeEnv(CEIEnv):
    """Put the red cube on the green one and let go.

    robosuite's Stack scene with its own object physics, sizes and placement: both cubes lie within 8 cm of the table's
    centre along x and y, at any yaw, as near to each other as robosuite lets them.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (22,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0 to 2, 11 to 13 | centre of the red, of the green cube, world | m | x, y in [-0.08, 0.08], 0.065 apart; z on the table |
    | 3 to 6, 14 to 17 | orientation, unit quaternion w, x, y, z | - | any yaw |
    | 7 to 9, 18 to 20 | half sizes | m | 0.020; 0.025 |
    | 10, 21 | mass | kg | 1000 kg/m^3 times the volume |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a
    row, the red cube touches the green one with its centre more than 4 cm above the table (as in robosuite) and nothing of
    the robot touches it (robosuite asks only for no grasp). `info["failure"]` says why not yet: never grasped, lower cube
    pushed, dropped, not released, timed out. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws cubes and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "StackCube"
    task_text: ClassVar[str] = "Put the red cube on the green cube."
    state_names: ClassVar[tuple[str, ...]] = state_names("red") + state_names("green")

    def make_robosuite(self, **robot_arguments: Any) -> Any:
        import robosuite

        return robosuite.make("Stack", **robot_arguments)

    def workspace_world(self) -> Array:
        return np.array([[-0.35, -0.35, TABLE_Z_M + 0.004], [0.25, 0.35, TABLE_Z_M + 0.45]])

    def sample_state(self, rng: np.random.Generator) -> Array:
        red = green = np.zeros(2)
        while np.linalg.norm(red - green) < APART_M:
            red, green = rng.uniform(-PLACEMENT_M, PLACEMENT_M, (2, 2))
        yaws = rng.uniform(-np.pi, np.pi, 2)
        cubes = zip((red, green), yaws, HALF_SIZES_M, strict=True)
        return np.concatenate([cube_on_table(x, y, yaw, np.full(3, half)) for (x, y), yaw, half in cubes])

    def apply_state(self, state: Array) -> None:
        self._red.apply(state[:STATE_SIZE])
        self._green.apply(state[STATE_SIZE:])

    def read_state(self) -> Array:
        return np.concatenate([self._red.read(), self._green.read()])

    def begin(self) -> None:
        self._start_green = self._green.position_world
        self._highest = 0.0

    def is_done(self) -> bool:
        height = self._red.position_world[2] - TABLE_Z_M
        self._highest = max(self._highest, height - self._red.half_height_m)
        touching = self.simulation.touching
        return height > LIFTED_M and touching(self._red.geoms, self._green.geoms) and not self._held_by_robot

    def failure_reason(self) -> str:
        if self._highest < OFF_TABLE_M:
            return "never grasped"
        if np.linalg.norm((self._green.position_world - self._start_green)[:2]) > PUSHED_M:
            return "lower cube pushed"
        if self._red.position_world[2] - TABLE_Z_M < LIFTED_M:
            return "dropped"
        return "not released" if self._held_by_robot else "timed out"

    @property
    def _held_by_robot(self) -> bool:
        return self.simulation.touching(self._red.geoms, self.simulation.robot_geoms)

    @cached_property
    def _red(self) -> Cube:
        return Cube(self.model, self.simulation.data, "cubeA_main")

    @cached_property
    def _green(self) -> Cube:
        return Cube(self.model, self.simulation.data, "cubeB_main")
