"""PickCup: lift a cup."""

from typing import ClassVar

import numpy as np

from cei_envs.tasks.lifted import LiftedEnv
from cei_envs.tasks.objects import names_of
from cei_envs.tasks.placed import Placed
from cei_gym.arrays import Array

CUP = Placed("cup")
FRONT_X_M, PLACEMENT_M, YAW_RAD = -0.02, 0.08, np.radians(20)
UPRIGHT_RAD = np.radians(25)


class PickCupEnv(LiftedEnv):
    """Lift a cup by 5 cm and keep it upright.

    A hollow cup of hard plastic, 70 mm wide at its top, 52 mm at its bottom and 95 mm high, 60 g, friction 0.6, near the middle of
    robosuite's table.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (7,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | where the cup stands, world | m | x in [-0.10, 0.06], y in [-0.08, 0.08]; z of the table |
    | 3, 4, 5, 6 | its orientation, unit quaternion w, x, y, z | - | yaw within 20 degrees |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a row, the cup
    is at least 5 cm above its start and upright within 25 degrees. `info["failure"]` says why not yet: tipped, never grasped, slipped, too
    low. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws the cup's place and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "PickCup"
    task_text: ClassVar[str] = "Pick up the cup."
    lifted: ClassVar[Placed] = CUP
    objects: ClassVar[tuple[Placed, ...]] = (CUP,)
    state_names: ClassVar[tuple[str, ...]] = names_of(*objects)

    def sample_state(self, rng: np.random.Generator) -> Array:
        x, y = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2) + [FRONT_X_M, 0.0]
        return CUP.at(x, y, rng.uniform(-YAW_RAD, YAW_RAD))

    def is_done(self) -> bool:
        return super().is_done() and self._is_upright

    def failure_reason(self) -> str:
        return super().failure_reason() if self._is_upright else "tipped"

    @property
    def _is_upright(self) -> bool:
        return bool(CUP.T_world(self.simulation)[2, 2] > np.cos(UPRIGHT_RAD))
