"""InsertFlower: put a bouquet into a vase."""

from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.objects import names_of
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.put_into import PutIntoEnv
from cei_gym.arrays import Array

BOUQUET, HOLDER, VASE = Placed("bouquet"), Placed("holder", free=False), Placed("vase", free=False)
FRONT_X_M, RIGHT_Y_M, PLACEMENT_M = -0.02, -0.13, 0.08
VASE_X_M, VASE_Y_M, VASE_PLACEMENT_M = -0.02, 0.13, 0.02
YAW_RAD = np.radians(20)
HOLE_BOTTOM_M, HOLE_DEPTH_M, HOLE_PLAY_M = 0.0108, 0.040, 0.0028  # play to each side: the stem leans
RIM_M, INSERTED_M, INSIDE_M = 0.120, 0.040, 0.022


class InsertFlowerEnv(PutIntoEnv):
    """Put a bouquet into a vase and let go.

    Flowers on a stem of 10 mm, 20 cm long in all and 25 g, friction 0.7, stand in a holder on the right of robosuite's table: a fixed
    block, 6 cm wide and 5 cm high, with a hole of 16 mm, 4 cm deep, in which the stem leans by 8 degrees. The vase is fixed on the left,
    44 mm wide inside and 12 cm high.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (13,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | lower end of the stem, world | m | in the hole |
    | 3, 4, 5, 6 | orientation of the bouquet, unit quaternion w, x, y, z; the stem is along its z | - | leaning to any side |
    | 7, 8 | middle of the holder, world | m | x in [-0.10, 0.06], y in [-0.21, -0.05] |
    | 9 | its yaw | rad | within 20 degrees |
    | 10, 11 | middle of the vase, world | m | x in [-0.04, 0.00], y in [0.11, 0.15] |
    | 12 | its yaw | rad | within 20 degrees |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a row, the lower
    end of the stem is in the vase, at least 4 cm below its rim, and nothing of the robot touches the bouquet. `info["failure"]` says why not
    yet: never grasped, dropped, not released. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws holder, vase, where the bouquet leans, and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "InsertFlower"
    task_text: ClassVar[str] = "Put the flowers into the vase."
    objects: ClassVar[tuple[Placed, ...]] = (BOUQUET, HOLDER, VASE)
    state_names: ClassVar[tuple[str, ...]] = names_of(*objects)

    def sample_state(self, rng: np.random.Generator) -> Array:
        holder = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2) + [FRONT_X_M, RIGHT_Y_M]
        vase = rng.uniform(-VASE_PLACEMENT_M, VASE_PLACEMENT_M, 2) + [VASE_X_M, VASE_Y_M]
        yaw, vase_yaw = rng.uniform(-YAW_RAD, YAW_RAD, 2)
        bouquet = _leaning(holder[0], holder[1], rng.uniform(-np.pi, np.pi))
        return np.concatenate([bouquet, HOLDER.at(holder[0], holder[1], yaw), VASE.at(vase[0], vase[1], vase_yaw)])

    @property
    def is_inside(self) -> bool:
        x, y, z, _ = np.linalg.inv(VASE.T_world(self.simulation)) @ BOUQUET.T_world(self.simulation)[:, 3]
        return bool(np.hypot(x, y) < INSIDE_M and 0 < z < RIM_M - INSERTED_M)


def _leaning(x_m: float, y_m: float, heading_rad: float) -> Array:
    """(7,) state of the bouquet in a holder at x, y, leaning as far as the hole lets it."""
    towards = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    lean_rad = np.arctan2(2 * HOLE_PLAY_M, HOLE_DEPTH_M)
    rotation = Rotation.from_rotvec(lean_rad * np.cross([0, 0, 1], towards))
    lower_end = np.array([x_m, y_m, TABLE_Z_M + HOLE_BOTTOM_M]) - HOLE_PLAY_M * towards
    return np.concatenate([lower_end, rotation.as_quat(scalar_first=True)])
