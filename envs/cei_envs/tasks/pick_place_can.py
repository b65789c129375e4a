"""PickPlaceCan: robosuite's own, for any robot."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from cei_envs.tasks.objects import names_of
from cei_envs.tasks.of_robosuite import OfRobosuite
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.put_into import PutIntoEnv
from cei_envs.tasks.stored_model import StoredModel
from cei_gym.arrays import Array

CAN = Placed("Can")
BIN_1_M, BIN_2_M = np.array([0.10, -0.25, 0.80]), np.array([0.10, 0.28, 0.80])
FLOOR_Z_M = 0.82
"""Of both bins, inside."""
CAN_Z_M = FLOOR_Z_M + 0.040
PLACEMENT_M = np.array([0.110, 0.160])  # the bin's half sizes, less 5 cm, less the can's radius as robosuite takes it
COMPARTMENT_M = np.array([0.195, 0.245])


class PickPlaceCanEnv(PutIntoEnv, OfRobosuite):
    """robosuite's PickPlaceCan: take the can out of one bin and put it into its compartment of the other.

    robosuite's bins, can, placement and check. What robosuite puts out of sight (milk, bread, cereal), and the pictures of objects that it shows
    where they belong, are not there: a depth camera would see them.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (7,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | origin of the can, world | m | x in [-0.01, 0.21], y in [-0.41, -0.09]; z on the floor of the bin |
    | 3, 4, 5, 6 | its orientation, unit quaternion w, x, y, z | - | any yaw |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a row, the can's
    origin is in its compartment, 19.5 x 24.5 cm and 10 cm high (as in robosuite), and nothing of the robot touches it, where robosuite asks that its
    gripper's middle is more than 4 cm away. `info["failure"]` says why not yet: never grasped, dropped, not released. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws can and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`.
    """

    task: ClassVar[str] = "PickPlaceCan"
    task_text: ClassVar[str] = "Put the can into its bin."
    objects: ClassVar[tuple[Placed, ...]] = (CAN,)
    state_names: ClassVar[tuple[str, ...]] = names_of(CAN)
    fixtures: ClassVar[Mapping[str, tuple[float, float, float]]] = {
        "bin1": (0.10, -0.25, 0.80),
        "bin2": (0.10, 0.28, 0.80),
    }
    surface_z_m: ClassVar[float] = FLOOR_Z_M

    def make_robosuite(self, **robot_arguments: Any) -> Any:
        from cei_envs.tasks.can_bins import CanBins

        return CanBins(**robot_arguments)

    def workspace_world(self) -> Array:
        return np.array([[-0.12, -0.51, FLOOR_Z_M + 0.004], [0.32, 0.54, FLOOR_Z_M + 0.45]])

    def sample_state(self, rng: np.random.Generator) -> Array:
        x, y = BIN_1_M[:2] + rng.uniform(-PLACEMENT_M, PLACEMENT_M)
        return CAN.at(x, y, rng.uniform(-np.pi, np.pi), CAN_Z_M)

    @property
    def is_inside(self) -> bool:
        x, y, z = CAN.T_world(self.simulation)[:3, 3] - BIN_2_M
        return bool(0 < x < COMPARTMENT_M[0] and 0 < y < COMPARTMENT_M[1] and 0 < z < 0.1)

    @classmethod
    def stored_state(cls, model: StoredModel, states: Array) -> Array:
        return model.joint("Can_joint0", states)
