"""NutAssemblySquare: robosuite's own, for any robot."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from cei_envs.tasks.objects import names_of
from cei_envs.tasks.of_robosuite import OfRobosuite
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.put_into import PutIntoEnv
from cei_envs.tasks.stored_model import StoredModel
from cei_gym.arrays import Array

NUT = Placed("SquareNut")
PEG_M = np.array([0.23, 0.10])
TABLE_Z_M = 0.82
NUT_Z_M = TABLE_Z_M + 0.01
PEG_TOP_M = 0.95
X_M, Y_M = (-0.115, -0.110), (0.110, 0.225)
ON_PEG_M, LOW_M = 0.03, 0.05
_AWAY = ("RoundNut_joint0", (10.0, 10.0, 0.05, 1.0, 0.0, 0.0, 0.0))  # robosuite: 10 m above that floor


class NutAssemblySquareEnv(PutIntoEnv, OfRobosuite):
    """robosuite's NutAssemblySquare: put the square nut over the square peg and let go.

    robosuite's table, pegs, nut, placement and check; its round nut lies on the floor far away.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (7,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | middle of the nut's hole, world | m | x in [-0.115, -0.110], y in [0.110, 0.225]; z on the table |
    | 3, 4, 5, 6 | its orientation, unit quaternion w, x, y, z; at yaw 0 its handle is along +x | - | any yaw |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): for 20 control periods (1 s) in a row, the middle of
    the nut is within 3 cm of the peg's along x and y and less than 5 cm above the table (as in robosuite), and nothing of the robot touches it, where
    robosuite asks that its gripper's middle is more than 4 cm away. `info["failure"]` says why not yet: never grasped, dropped, not released.
    Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws nut and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`.
    """

    task: ClassVar[str] = "NutAssemblySquare"
    task_text: ClassVar[str] = "Put the square nut on the square peg."
    objects: ClassVar[tuple[Placed, ...]] = (NUT,)
    state_names: ClassVar[tuple[str, ...]] = names_of(NUT)
    fixtures: ClassVar[Mapping[str, tuple[float, float, float]]] = {
        "table": (0.0, 0.0, 0.795),
        "peg1": (0.23, 0.10, 0.85),
    }
    surface_z_m: ClassVar[float] = TABLE_Z_M

    def make_robosuite(self, **robot_arguments: Any) -> Any:
        import robosuite

        return robosuite.make("NutAssemblySquare", **robot_arguments)

    def workspace_world(self) -> Array:
        return np.array([[-0.35, -0.35, TABLE_Z_M + 0.004], [0.35, 0.35, TABLE_Z_M + 0.45]])

    def sample_state(self, rng: np.random.Generator) -> Array:
        return NUT.at(rng.uniform(*X_M), rng.uniform(*Y_M), rng.uniform(-np.pi, np.pi), NUT_Z_M)

    def apply_state(self, state: Array) -> None:
        super().apply_state(state)
        joint, place = _AWAY
        self.simulation.data.joint(joint).qpos = place

    @property
    def is_inside(self) -> bool:
        position = NUT.T_world(self.simulation)[:3, 3]
        near = np.abs(position[:2] - PEG_M) < ON_PEG_M
        return bool(near.all() and position[2] < TABLE_Z_M + LOW_M)

    @classmethod
    def stored_state(cls, model: StoredModel, states: Array) -> Array:
        return model.joint("SquareNut_joint0", states)
