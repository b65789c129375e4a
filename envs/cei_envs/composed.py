"""The simulation of an embodiment that robosuite does not have: composed (`composing`), driven by position servos."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from cei_envs.composing import FORCE, PREFIX, TORQUE, compose, joint_names, scene_without_robot
from cei_envs.rules import of_composed
from cei_envs.simulation import CONTROL_HZ, Simulation
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.drives import drives
from cei_gym.errors import CEIError


class ComposedSimulation(Simulation):
    """A task's scene with any embodiment in it.

    Args:
        embodiment: arm and end-effector.
        make: builds the task's robosuite environment from its robot arguments.
        T_world_base: (4, 4) where the base stands; default: where robosuite's Panda stands in this task.
    """

    def __init__(self, embodiment: Embodiment, make: Callable[..., Any], T_world_base: Array | None = None) -> None:
        if embodiment.arm is None or embodiment.end_effector is None:
            raise CEIError(f"{embodiment.name}: a simulation needs an arm and an end-effector.")
        scene, T_world_panda = scene_without_robot(make)
        place = T_world_panda if T_world_base is None else T_world_base
        model = compose(scene, embodiment, place)
        physics = of_composed(embodiment, drives(embodiment), model.npair, place, T_world_base is not None)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        names = joint_names(embodiment)
        joints = [model.joint(name).id for name in names]
        self._coupled = embodiment.coupled
        self._servos = [model.actuator(names[q]).id for q in self._coupled.independent]
        super().__init__(model, data, joints, np.array(self._coupled.independent), (PREFIX,), place, physics)
        self._steps = round(1 / (CONTROL_HZ * model.opt.timestep))

    @property
    def wrench(self) -> Array:
        """See `Simulation`; in the frame of the end-effector's first link."""
        return np.concatenate([self.data.sensor(name).data for name in (FORCE, TORQUE)])

    def reset(self, qpos: Array) -> None:
        """See `Simulation`."""
        mujoco.mj_resetData(self.model, self.data)
        self._place(qpos)

    def forward(self) -> None:
        """See `Simulation`."""
        self._aim(self.qpos)
        mujoco.mj_forward(self.model, self.data)

    def tick(self, target: Array) -> None:
        """See `Simulation`; followers go where their leaders take them."""
        self._aim(target)
        mujoco.mj_step(self.model, self.data, self._steps)

    def _aim(self, target: Array) -> None:
        self.data.ctrl[self._servos] = self._coupled.reduce(target)

    def close(self) -> None:
        """See `Simulation`."""
