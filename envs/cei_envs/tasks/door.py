"""Door: robosuite's own, for any robot."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.of_robosuite import OfRobosuite
from cei_envs.tasks.placed import Placed
from cei_envs.tasks.stored_model import StoredModel
from cei_gym.arrays import Array

X_M, Y_M = (-0.13, -0.11), (-0.36, -0.34)
YAW_RAD = (-np.pi / 2 - 0.25, -np.pi / 2)
DOOR_Z_M = TABLE_Z_M + 0.30
DOOR = Placed("Door", free=False, z_m=DOOR_Z_M)
OPENED_RAD = 0.3
MOVED_RAD = 0.02
TURNED_RAD = 0.2


class DoorEnv(OfRobosuite):
    """robosuite's Door: turn the handle and pull the door open.

    robosuite's door with its latch, on its table to the right of the robot, with robosuite's placement and check. The latch holds the door
    until the handle, which a spring (1 N m/rad) holds level, is turned by some 65 degrees.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (5,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1 | origin of the door and its frame, world | m | x in [-0.13, -0.11], y in [-0.36, -0.34] |
    | 2 | its yaw | rad | [-pi/2 - 0.25, -pi/2] |
    | 3 | how far the door is open | rad | 0 |
    | 4 | how far the handle is turned; above 0 its end is lower | rad | 0 |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): the door has been open by more than 0.3 rad (as in
    robosuite) for 20 control periods (1 s) in a row. `info["failure"]` says why not yet: handle never turned, still shut, slipped, too little.
    Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws the door's place and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`.
    """

    task: ClassVar[str] = "Door"
    task_text: ClassVar[str] = "Turn the handle and open the door."
    state_names: ClassVar[tuple[str, ...]] = (
        "door.x_m",
        "door.y_m",
        "door.yaw_rad",
        "door.open_rad",
        "handle.turn_rad",
    )

    fixtures: ClassVar[Mapping[str, tuple[float, float, float]]] = {"table": (-0.2, -0.35, 0.775)}
    surface_z_m: ClassVar[float] = TABLE_Z_M

    def make_robosuite(self, **robot_arguments: Any) -> Any:
        import robosuite

        return robosuite.make("Door", **robot_arguments)

    def workspace_world(self) -> Array:
        return np.array([[-0.40, -0.50, TABLE_Z_M + 0.004], [0.25, 0.20, TABLE_Z_M + 0.62]])

    def sample_state(self, rng: np.random.Generator) -> Array:
        return np.array([rng.uniform(*X_M), rng.uniform(*Y_M), rng.uniform(*YAW_RAD), 0.0, 0.0])

    def apply_state(self, state: Array) -> None:
        DOOR.apply(self.simulation, state[:3])
        for joint, turned_rad in zip(("Door_hinge", "Door_latch_joint"), state[3:], strict=True):
            self.simulation.data.joint(joint).qpos[:] = turned_rad

    def read_state(self) -> Array:
        return np.array([*DOOR.read(self.simulation), self._open_rad, self._turn_rad])

    def begin(self) -> None:
        self._widest = self._farthest = 0.0

    def is_done(self) -> bool:
        self._widest, self._farthest = max(self._widest, self._open_rad), max(self._farthest, abs(self._turn_rad))
        return self._open_rad > OPENED_RAD

    def failure_reason(self) -> str:
        if self._farthest < TURNED_RAD:
            return "handle never turned"
        if self._widest < MOVED_RAD:
            return "still shut"
        return "slipped" if self._open_rad < self._widest / 2 else "too little"

    @property
    def _open_rad(self) -> float:
        return float(self.simulation.data.joint("Door_hinge").qpos[0])

    @property
    def _turn_rad(self) -> float:
        return float(self.simulation.data.joint("Door_latch_joint").qpos[0])

    @classmethod
    def stored_state(cls, model: StoredModel, states: Array) -> Array:
        door = model.place("Door_main")
        joints = [model.joint(f"Door_{name}", states) for name in ("hinge", "latch_joint")]
        place = [door[0], door[1], 2 * np.arctan2(door[6], door[3])]
        return np.column_stack([np.tile(place, (len(states), 1)), *joints])
