"""A robosuite simulation of one embodiment that robosuite has: built, read and driven in the embodiment's own joint layout."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from robosuite.controllers import load_composite_controller_config
from robosuite.controllers.composite.composite_controller import CompositeController, register_composite_controller

from cei_envs.gripper import register_gripper, require_absolute_control
from cei_envs.rules import of_mounted
from cei_envs.simulation import CONTROL_HZ, Simulation, pose_of
from cei_gym.arrays import Array
from cei_gym.embodiment import ArmSpec, Embodiment
from cei_gym.errors import CEIError


@register_composite_controller
class StillBaseController(CompositeController):
    """robosuite's basic controller for a base that stands still.

    The same commands in half the time: robosuite derives the limits of actions, where the base is, and the gripper's
    Jacobian anew in each of the 25 physics steps of a control period, which takes longer than the physics.
    """

    name = "CEI_STILL_BASE"

    @cached_property
    def action_limits(self):
        return super().action_limits

    def update_state(self) -> None:
        """Nothing to do: joint positions do not depend on the base."""

    def _init_controllers(self) -> None:
        super()._init_controllers()
        for arm in self.arms:
            self.part_controllers[arm].ref_name = None  # nor on where the gripper is


class MountedSimulation(Simulation):
    """robosuite's physics and controllers around one embodiment; `robosuite` is its environment.

    Args:
        embodiment: arm and end-effector.
        make: builds the robosuite environment from its robot arguments.
        stock_physics: apply only the physics exceptions without which nothing works.
    """

    def __init__(self, embodiment: Embodiment, make: Callable[..., Any], stock_physics: bool = False) -> None:
        arm_spec, hand_spec = embodiment.arm, embodiment.end_effector
        if arm_spec is None or hand_spec is None:
            raise CEIError(f"{embodiment.name}: a simulation needs an arm and an end-effector.")
        self.robosuite = make(
            robots=arm_spec.simulator_name,
            gripper_types=register_gripper(hand_spec, stock_physics),
            controller_configs=_controllers(arm_spec),
            initialization_noise=None,
            control_freq=CONTROL_HZ,
            use_camera_obs=False,
            has_renderer=False,
            has_offscreen_renderer=False,
            hard_reset=False,
            ignore_done=True,
        )
        self.robosuite.reset()
        # The environment reads the model itself; robosuite's sensors would only cost time.
        for name in self.robosuite.observation_names:
            self.robosuite.modify_observable(name, "enabled", False)
            self.robosuite.modify_observable(name, "active", False)
        model: mujoco.MjModel = self.robosuite.sim.model._model
        robot = self.robosuite.robots[0]
        arm, hand = robot.robot_model.naming_prefix, robot.gripper["right"].naming_prefix
        prefixes = [arm if q < embodiment.n_arm else hand for q in range(len(embodiment.joint_names))]
        joints = [model.joint(p + n).id for p, n in zip(prefixes, embodiment.joint_names, strict=True)]
        actuators = [model.actuator(n).id for n in robot.gripper["right"].actuators]
        index = {joint: q for q, joint in enumerate(joints)}
        # Actuators come in another order than joints, and fewer: map by the joint that each drives.
        self._driven_hand = [index[model.actuator_trnid[a, 0]] for a in actuators]
        self._n_arm = embodiment.n_arm
        self._hand = hand
        data: mujoco.MjData = self.robosuite.sim.data._data
        super().__init__(
            model,
            data,
            joints,
            np.array([*range(embodiment.n_arm), *self._driven_hand]),
            (arm, hand),
            pose_of(data, robot.robot_model.root_body),
            of_mounted(embodiment, stock_physics),
        )

    @property
    def wrench(self) -> Array:
        """See `Simulation`; in the frame of robosuite's sensor."""
        return np.concatenate([self.data.sensor(f"{self._hand}{kind}_ee").data for kind in ("force", "torque")])

    def reset(self, qpos: Array) -> None:
        """See `Simulation`."""
        self.robosuite.reset()
        self._place(qpos)
        self.data.ctrl[:] = 0.0

    def forward(self) -> None:
        """See `Simulation`."""
        mujoco.mj_forward(self.model, self.data)
        self.robosuite.robots[0].composite_controller.reset()

    def tick(self, target: Array) -> None:
        """See `Simulation`; through robosuite's controllers."""
        self.robosuite.step(np.concatenate([target[: self._n_arm], target[self._driven_hand]]))

    def close(self) -> None:
        """See `Simulation`."""
        self.robosuite.close()


def _controllers(arm: ArmSpec) -> dict[str, Any]:
    config = load_composite_controller_config(controller="BASIC")
    assert config is not None  # it ships with robosuite
    parameters = require_absolute_control(arm.name, arm.physics).parameters
    config["type"] = StillBaseController.name
    config["body_parts"] = {
        "right": {
            "type": "JOINT_POSITION",
            "input_type": "absolute",
            # Wider than any joint, so that robosuite neither scales nor clips a target.
            "input_max": 10,
            "input_min": -10,
            "output_max": 10,
            "output_min": -10,
            "kp": parameters["kp"],
            "damping_ratio": parameters["damping_ratio"],
            "impedance_mode": "fixed",
            "kp_limits": [0, 1000],
            "damping_ratio_limits": [0, 10],
            "qpos_limits": None,
            "interpolation": None,
            "ramp_ratio": 0.2,
            "gripper": {"type": "GRIP", "use_action_scaling": False},
        }
    }
    return config
