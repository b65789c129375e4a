"""PushCube: enclose a cube and push it to the right."""

from typing import ClassVar

import numpy as np

from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.objects import ObjectsEnv, names_of
from cei_envs.tasks.placed import Placed
from cei_gym.arrays import Array

CUBE = Placed("cube")
HALF_M = 0.025
FRONT_X_M, LEFT_Y_M, PLACEMENT_M = -0.02, 0.10, 0.08
YAW_RAD = np.radians(20)
PUSHED_M, DRIFT_M = 0.20, 0.05
MOVED_M, LIFTED_M = 0.01, 0.01


class PushCubeEnv(ObjectsEnv):
    """Enclose a cube and push it 20 cm to the right.

    A wooden cube of 50 mm and 125 g on robosuite's table, friction 0.5, left of the middle as the robot sees it (its left is y > 0).

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (7,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | centre of the cube, world | m | x in [-0.10, 0.06], y in [0.02, 0.18]; z on the table |
    | 3, 4, 5, 6 | orientation, unit quaternion w, x, y, z | - | yaw within 20 degrees |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a row, the cube
    has been at least 20 cm to the right of its start, less than 5 cm off that line, and on the table. `info["failure"]` says why not
    yet: never pushed, lifted, off the line, too short. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws the cube's place and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "PushCube"
    task_text: ClassVar[str] = "Push the cube to the right."
    objects: ClassVar[tuple[Placed, ...]] = (CUBE,)
    state_names: ClassVar[tuple[str, ...]] = names_of(*objects)

    def sample_state(self, rng: np.random.Generator) -> Array:
        x, y = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2) + [FRONT_X_M, LEFT_Y_M]
        return CUBE.at(x, y, rng.uniform(-YAW_RAD, YAW_RAD), TABLE_Z_M + HALF_M)

    def begin(self) -> None:
        self._start = CUBE.T_world(self.simulation)[:3, 3]

    def is_done(self) -> bool:
        x, y, z = self._moved
        return bool(-y >= PUSHED_M and abs(x) < DRIFT_M and z < LIFTED_M)

    def failure_reason(self) -> str:
        x, y, z = self._moved
        if np.hypot(x, y) < MOVED_M:
            return "never pushed"
        if z >= LIFTED_M:
            return "lifted"
        return "off the line" if abs(x) >= DRIFT_M else "too short"

    @property
    def _moved(self) -> Array:
        """(3,) m since the start."""
        return CUBE.T_world(self.simulation)[:3, 3] - self._start
