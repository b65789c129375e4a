"""OpenDrawer: pull a drawer open by its handle."""

from typing import Any, ClassVar

import numpy as np

from cei_envs.environment import CEIEnv
from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.placed import Placed
from cei_gym.arrays import Array

CABINET = Placed("cabinet", free=False)
FRONT_X_M = (0.06, 0.12)
PLACEMENT_Y_M = 0.08
YAW_RAD = 0.25
OPENED_M = 0.10
MOVED_M = 0.01


class OpenDrawerEnv(CEIEnv):
    """Pull a drawer open by its handle.

    A cabinet of boxes on robosuite's table (robosuite ships none), fixed where it stands; its one drawer slides 15 cm, with
    friction (1 N) and damping (20 N s/m). The handle is a bar 12 cm long and 16 mm thick, 7 cm above the table and 7 cm in
    front, so that a hand reaches it from above with fingers on both sides.

    ### Action space
    `Box(n,)`, float32: absolute joint position targets, as in `PickCubeEnv`.

    ### Observation space
    `Dict` with `agent_pos` (n,) and `point_cloud` (1024, 3) as in `PickCubeEnv`, and

    | index of `environment_state` (4,) | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1 | middle of the cabinet's front, world | m | x in [0.06, 0.12], y in [-0.08, 0.08] |
    | 2 | its yaw; at 0 the drawer opens towards -x, where the robot stands | rad | [-0.25, 0.25] |
    | 3 | how far the drawer is open | m | 0 |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): the drawer has been open by at
    least 10 cm for 20 control periods (1 s) in a row. `info["failure"]` says why not yet: never pulled, slipped,
    unreachable, timed out. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws the cabinet's place and joints (home, or `start_qpos`, plus 0.02 rad of noise);
    `options={"environment_state": ..., "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `clouds`, `cameras`, `depth_noise`, `colours`,
    `start_qpos`, `sensors`, `render_mode`, `pixels`.
    """

    task: ClassVar[str] = "OpenDrawer"
    task_text: ClassVar[str] = "Open the drawer."
    state_names: ClassVar[tuple[str, ...]] = (*CABINET.state_names, "drawer.opening_m")

    def make_robosuite(self, **robot_arguments: Any) -> Any:
        from cei_envs.tasks.tabletop import Tabletop

        return Tabletop([CABINET], **robot_arguments)

    def workspace_world(self) -> Array:
        return np.array([[-0.35, -0.35, TABLE_Z_M + 0.004], [0.35, 0.35, TABLE_Z_M + 0.45]])

    def sample_state(self, rng: np.random.Generator) -> Array:
        x, y = rng.uniform(*FRONT_X_M), rng.uniform(-PLACEMENT_Y_M, PLACEMENT_Y_M)
        return np.array([x, y, rng.uniform(-YAW_RAD, YAW_RAD), 0.0])

    def apply_state(self, state: Array) -> None:
        CABINET.apply(self.simulation, state[:3])
        self.simulation.data.joint("cabinet_slide").qpos[:] = state[3]

    def read_state(self) -> Array:
        return np.array([*CABINET.read(self.simulation), self._opening_m])

    def begin(self) -> None:
        self._widest = 0.0

    def is_done(self) -> bool:
        self._widest = max(self._widest, self._opening_m)
        return self._opening_m >= OPENED_M

    def failure_reason(self) -> str:
        if self._widest < MOVED_M:
            return "never pulled"
        return "slipped" if self._opening_m < OPENED_M else "timed out"

    @property
    def _opening_m(self) -> float:
        return float(self.simulation.data.joint("cabinet_slide").qpos[0])
