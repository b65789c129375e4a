"""PickCube: lift a cube off the table and hold it."""

from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from cei_envs.environment import CEIEnv
from cei_envs.tasks.cube import TABLE_Z_M, Cube, cube_on_table, state_names
from cei_gym.arrays import Array

PLACEMENT_M = 0.10
HALF_SIZE_M = (0.020, 0.022)
LIFTED_M = 0.05
OFF_TABLE_M = 0.01


class PickCubeEnv(CEIEnv):
    """Lift a cube off the table and hold it.

    robosuite's Lift scene with its own object physics. The cube starts anywhere within 10 cm of the table's centre along
    x and y, at any yaw: replaying one demonstration blindly fails.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets of arm, then end-effector, in the layout of `agent_pos`; limits are
    the joints' own. A step holds its target until all driven joints have reached it (arm 0.02 rad; end-effector 0.05 rad or
    2 mm) or stopped moving, for at most `max_hold_ticks` control periods of 1/20 s. Targets of joints that have no actuator
    (followers of RobotiqThreeFinger) are ignored.

    ### Observation space
    `Dict`:

    | key | shape | meaning | unit | min | max |
    |---|---|---|---|---|---|
    | `agent_pos` | (n,) | joint positions of arm, then end-effector | rad; m for slides | -inf | inf |
    | `point_cloud` | (1024, 3) | what the cameras see in the workspace, robot included; world frame; with `colours` (1024, 6), r, g, b in [0, 1] | m | workspace | workspace |
    | `environment_state` | (11,) | the cube, as below | as below | -inf | inf |
    | `pixels` | camera to (120, 160, 3) uint8 | with `pixels`: the picture of each camera | - | 0 | 255 |

    | index of `environment_state` | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | centre of the cube, world | m | x, y in [-0.1, 0.1]; z on the table |
    | 3, 4, 5, 6 | orientation, unit quaternion w, x, y, z | - | any yaw |
    | 7, 8, 9 | half sizes | m | [0.020, 0.022] |
    | 10 | mass | kg | 1000 kg/m^3 times the volume |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): the cube has been at least 5 cm
    above its start (robosuite's Lift asks for 2) for 20 control periods (1 s) in a row. `info["failure"]` says why not yet:
    never grasped, slipped, dropped, unreachable (the arm kept falling short of its targets), timed out. Truncated after 400
    steps.

    ### Start
    `reset(seed=...)` draws cube and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "PickCube"
    task_text: ClassVar[str] = "Pick up the cube and hold it."
    state_names: ClassVar[tuple[str, ...]] = state_names("cube")

    def make_robosuite(self, **robot_arguments: Any) -> Any:
        import robosuite

        return robosuite.make("Lift", **robot_arguments)

    def workspace_world(self) -> Array:
        return np.array([[-0.35, -0.35, TABLE_Z_M + 0.004], [0.25, 0.35, TABLE_Z_M + 0.45]])

    def sample_state(self, rng: np.random.Generator) -> Array:
        half = rng.uniform(*HALF_SIZE_M, 3)
        x, y = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2)
        return cube_on_table(x, y, rng.uniform(-np.pi, np.pi), half)

    def apply_state(self, state: Array) -> None:
        self.cube.apply(state)

    def read_state(self) -> Array:
        return self.cube.read()

    def begin(self) -> None:
        self._start_z = self.cube.position_world[2]
        self._highest = 0.0

    def is_done(self) -> bool:
        lift = self._lift_m
        self._highest = max(self._highest, lift)
        return lift >= LIFTED_M

    def failure_reason(self) -> str:
        if self._highest < OFF_TABLE_M:
            return "never grasped"
        if self._lift_m < OFF_TABLE_M:
            return "dropped" if self._highest >= LIFTED_M else "slipped"
        return "timed out"

    @cached_property
    def cube(self) -> Cube:
        """The cube in the simulation."""
        return Cube(self.model, self.simulation.data, "cube_main")

    @property
    def _lift_m(self) -> float:
        return self.cube.position_world[2] - self._start_z
