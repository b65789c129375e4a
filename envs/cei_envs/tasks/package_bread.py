"""PackageBread: take a slice of bread out of a toaster and put it into a bag."""

from typing import ClassVar

import numpy as np

from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.objects import names_of
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.put_into import PutIntoEnv
from cei_gym.arrays import Array

BREAD, TOASTER, BAG = Placed("bread"), Placed("toaster", free=False), Placed("bag", free=False)
FRONT_X_M, RIGHT_Y_M, PLACEMENT_M = -0.02, -0.15, 0.08
BAG_X_M, BAG_Y_M, BAG_PLACEMENT_M = -0.02, 0.16, 0.02
YAW_RAD = np.radians(20)
RACK_M = 0.035
MIDDLE_M = (0.0, 0.0, 0.050)  # of the slice
MOUTH_HALF_M = (0.045, 0.075)
SUNK_M = 0.070  # its middle above the table, in the bag: it stands on the bottom at 53 mm, and leans


class PackageBreadEnv(PutIntoEnv):
    """Take a slice of bread out of a toaster, put it into a bag and let go.

    A toasted slice, 100 x 100 x 14 mm and 40 g, friction 0.7, stands in the slot of a toaster, 20 mm wide, and 35 mm of it are out; the
    toaster, 9 x 18 x 10 cm, is fixed on the right of robosuite's table. The mouth of a bag, 9 x 15 cm and 10 cm deep, is fixed on the left: an
    open frame with walls that do not give, where a real bag is not rigid.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (13,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | middle of the slice's lower edge, world | m | in the middle of the slot, on its rack |
    | 3, 4, 5, 6 | its orientation, unit quaternion w, x, y, z | - | the toaster's |
    | 7, 8 | middle of the toaster, world | m | x in [-0.10, 0.06], y in [-0.23, -0.07] |
    | 9 | its yaw; at 0 the slot is along y | rad | within 20 degrees |
    | 10, 11 | middle of the bag, world | m | x in [-0.04, 0.00], y in [0.14, 0.18] |
    | 12 | its yaw; at 0 its mouth is longer along y | rad | within 20 degrees |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a row, the slice
    is in the bag, as far down as it goes, and nothing of the robot touches it. `info["failure"]` says why not yet: never grasped, dropped, not
    released. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws toaster, bag and joints (home, or `start_qpos`, plus 0.02 rad of noise); where the slice stands follows.
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "PackageBread"
    task_text: ClassVar[str] = "Put the bread into the bag."
    objects: ClassVar[tuple[Placed, ...]] = (BREAD, TOASTER, BAG)
    state_names: ClassVar[tuple[str, ...]] = names_of(*objects)

    def sample_state(self, rng: np.random.Generator) -> Array:
        x, y = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2) + [FRONT_X_M, RIGHT_Y_M]
        bag = rng.uniform(-BAG_PLACEMENT_M, BAG_PLACEMENT_M, 2) + [BAG_X_M, BAG_Y_M]
        yaw, bag_yaw = rng.uniform(-YAW_RAD, YAW_RAD, 2)
        bread = BREAD.at(x, y, yaw, TABLE_Z_M + RACK_M)
        return np.concatenate([bread, TOASTER.at(x, y, yaw), BAG.at(bag[0], bag[1], bag_yaw)])

    @property
    def is_inside(self) -> bool:
        T_bag_bread = np.linalg.inv(BAG.T_world(self.simulation)) @ BREAD.T_world(self.simulation)
        x, y, z = T_bag_bread[:3, :3] @ MIDDLE_M + T_bag_bread[:3, 3]
        return bool(abs(x) < MOUTH_HALF_M[0] and abs(y) < MOUTH_HALF_M[1] and z < SUNK_M)
