"""PlaceBird: put a toy bird into a box."""

from typing import ClassVar

import numpy as np

from cei_envs.tasks.objects import names_of
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.put_into import PutIntoEnv
from cei_gym.arrays import Array

BIRD, BOX = Placed("bird"), Placed("box", free=False)
FRONT_X_M, LEFT_Y_M, PLACEMENT_M = -0.02, 0.12, 0.08
YAW_RAD = np.radians(20)
BOX_X_M, BOX_Y_M, BOX_PLACEMENT_M = -0.02, -0.13, 0.02
INSIDE_M, RIM_M = 0.080, 0.080


class PlaceBirdEnv(PutIntoEnv):
    """Put a toy bird into a box and let go.

    A rubber bird of five convex parts, 66 x 46 x 44 mm and 70 g, stands on the left of robosuite's table; an open box, 16 x 16 cm inside and
    8 cm deep, is fixed on the right, 25 cm away on average.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (10,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | where the bird stands, world | m | x in [-0.10, 0.06], y in [0.04, 0.20]; z of the table |
    | 3, 4, 5, 6 | its orientation, unit quaternion w, x, y, z | - | yaw within 20 degrees |
    | 7, 8 | middle of the box, world | m | x in [-0.04, 0.00], y in [-0.15, -0.11] |
    | 9 | its yaw | rad | within 20 degrees |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a row, the bird
    is in the box, below its rim, and nothing of the robot touches it. `info["failure"]` says why not yet: never grasped, dropped, not
    released. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws bird, box and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "PlaceBird"
    task_text: ClassVar[str] = "Put the bird into the box."
    objects: ClassVar[tuple[Placed, ...]] = (BIRD, BOX)
    state_names: ClassVar[tuple[str, ...]] = names_of(*objects)

    def sample_state(self, rng: np.random.Generator) -> Array:
        bird = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2) + [FRONT_X_M, LEFT_Y_M]
        box = rng.uniform(-BOX_PLACEMENT_M, BOX_PLACEMENT_M, 2) + [BOX_X_M, BOX_Y_M]
        yaws = rng.uniform(-YAW_RAD, YAW_RAD, 2)
        return np.concatenate([BIRD.at(bird[0], bird[1], yaws[0]), BOX.at(box[0], box[1], yaws[1])])

    @property
    def is_inside(self) -> bool:
        T_box_bird = np.linalg.inv(BOX.T_world(self.simulation)) @ BIRD.T_world(self.simulation)
        x, y, z = T_box_bird[:3, 3]
        return bool(max(abs(x), abs(y)) < INSIDE_M and z < RIM_M)
