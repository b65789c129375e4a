"""PickCube: lift a cube off the table and hold it."""

from typing import Any, ClassVar

import mujoco
import numpy as np

from cei_envs.environment import CEIEnv

TABLE_Z_M = 0.8
TABLE_FRICTION = (1.0, 0.005, 0.0001)
PLACEMENT_M = 0.10
HALF_SIZE_M = (0.020, 0.022)
DENSITY_KG_M3 = 1000.0
LIFTED_M = 0.05
OFF_TABLE_M = 0.01
HELD_TICKS = 20


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
    | `point_cloud` | (1024, 3) | what the camera sees in the workspace, robot included; world frame | m | workspace | workspace |
    | `environment_state` | (11,) | the cube, as below | as below | -inf | inf |

    | index of `environment_state` | meaning | unit | at a start |
    |---|---|---|---|
    | 0, 1, 2 | centre of the cube, world | m | x, y in [-0.1, 0.1]; z on the table |
    | 3, 4, 5, 6 | orientation, unit quaternion w, x, y, z | - | any yaw |
    | 7, 8, 9 | half sizes | m | [0.020, 0.022] |
    | 10 | mass | kg | 1000 kg/m^3 times the volume |

    ### Reward, success and end
    Reward is 1 on success, else 0. Success (`info["is_success"]`, which also terminates): the cube has been at least 5 cm
    above its start for 20 control periods (1 s) in a row. `info["failure"]` says why not yet: never grasped, slipped, dropped,
    unreachable (the arm kept falling short of its targets), timed out. Truncated after 400 steps.

    ### Start
    `reset(seed=...)` draws cube and joints (home plus 0.02 rad of noise); `options={"environment_state": ...,
    "agent_pos": ...}` restores a recorded start exactly.

    ### Arguments
    See `CEIEnv`: `embodiment`, `max_hold_ticks`, `image_width`, `image_height`, `render_mode`.
    """

    task: ClassVar[str] = "PickCube"
    task_text: ClassVar[str] = "Pick up the cube and hold it."
    state_names: ClassVar[tuple[str, ...]] = (
        "cube.x_m",
        "cube.y_m",
        "cube.z_m",
        "cube.qw",
        "cube.qx",
        "cube.qy",
        "cube.qz",
        "cube.half_x_m",
        "cube.half_y_m",
        "cube.half_z_m",
        "cube.mass_kg",
    )

    def _make_robosuite(self, **robot_arguments) -> Any:
        import robosuite

        return robosuite.make("Lift", **robot_arguments)

    def _workspace_world(self) -> np.ndarray:
        return np.array([[-0.35, -0.35, TABLE_Z_M + 0.004], [0.25, 0.35, TABLE_Z_M + 0.45]])

    def _sample_state(self, rng: np.random.Generator) -> np.ndarray:
        half = rng.uniform(*HALF_SIZE_M, 3)
        x, y = rng.uniform(-PLACEMENT_M, PLACEMENT_M, 2)
        yaw = rng.uniform(-np.pi, np.pi)
        quat = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
        return np.array([x, y, TABLE_Z_M + half[2], *quat, *half, DENSITY_KG_M3 * 8 * half.prod()])

    def _apply_state(self, state: np.ndarray) -> None:
        model, data = self.model, self._simulation.data
        body, half, mass = self._cube, state[7:10], state[10]
        for geom in np.flatnonzero(model.geom_bodyid == body):
            model.geom_size[geom] = half
            model.geom_rbound[geom] = np.linalg.norm(half)
            model.geom_aabb[geom] = [0, 0, 0, *half]
        model.body_mass[body] = mass
        model.body_inertia[body] = mass / 3 * (np.square(half).sum() - np.square(half))
        saved = data.qpos.copy()
        mujoco.mj_setConst(model, data)
        data.qpos[:] = saved
        data.qpos[self._cube_qpos] = state[:7]

    def _read_state(self) -> np.ndarray:
        geom = np.flatnonzero(self.model.geom_bodyid == self._cube)[0]
        pose = self._simulation.data.qpos[self._cube_qpos]
        return np.array([*pose, *self.model.geom_size[geom], self.model.body_mass[self._cube]])

    def _begin(self) -> None:
        self._start_z = self._height()
        self._highest = 0.0
        self._held = 0

    def _observe_progress(self) -> None:
        lift = self._height() - self._start_z
        self._highest = max(self._highest, lift)
        self._held = self._held + 1 if lift >= LIFTED_M else 0

    def _is_success(self) -> bool:
        return self._held >= HELD_TICKS

    def failure_reason(self) -> str:
        lift = self._height() - self._start_z
        if self._highest < OFF_TABLE_M:
            return "never grasped"
        if lift < OFF_TABLE_M:
            return "dropped" if self._highest >= LIFTED_M else "slipped"
        return "timed out"

    @property
    def _cube(self) -> int:
        return self.model.body("cube_main").id

    @property
    def _cube_qpos(self) -> slice:
        address = self.model.jnt_qposadr[self.model.body_jntadr[self._cube]]
        return slice(address, address + 7)

    def _height(self) -> float:
        return float(self._simulation.data.xpos[self._cube, 2])
