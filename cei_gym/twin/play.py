"""Motions played in a twin."""

from dataclasses import dataclass

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.twin.robot import PREFIX
from cei_gym.twin.scene import OBJECT

_PERIODS = 5  # most that one frame waits for joints to arrive
_ARRIVED = 0.005  # rad or m from where they should be, or moved in a period
_AFTER = 10  # periods that the last frame is held
_SUPPORT_GEOM = 0


@dataclass(frozen=True)
class Played:
    """What became of what is held.

    Attributes:
        T_start_end: (4, 4) how it moved, in the world, from when it lay to the end.
        on_support: whether it touches the support at the end.
        finite: whether physics stayed finite.
    """

    T_start_end: Array
    on_support: bool
    finite: bool = True


class Player:
    """Plays a robot's motions in a scene.

    Args:
        model: of `build_scene`.
        embodiment: the robot in it.
        dt_s: between frames.
    """

    def __init__(self, model: mujoco.MjModel, embodiment: Embodiment, dt_s: float) -> None:
        self._model, self._embodiment = model, embodiment
        self._data = mujoco.MjData(model)
        joints = [model.joint(f"{PREFIX}{q}") for q in range(len(embodiment.joint_names))]
        self._address = np.array([int(joint.qposadr[0]) for joint in joints])
        names = [model.actuator(a).name for a in range(model.nu)]
        self._driven = np.array([int(name.removeprefix(PREFIX)) for name in names])
        self._steps = max(1, round(dt_s / model.opt.timestep))
        self._object = model.body(OBJECT).id
        self._free = int(model.joint(OBJECT).qposadr[0])
        self._friction = model.geom_friction.copy()

    def play(self, qpos: Array, action: Array, shift_world: Array | None = None, friction_scale: float = 1.0) -> Played:
        """Play a motion: each frame's targets are held until joints are there or at rest, as long as five frames.

        Args:
            qpos: (n,) joints at the start, rad or m.
            action: (T, n) targets, frame by frame.
            shift_world: (3,) by which what is held is moved before, m.
            friction_scale: factor on all friction.
        """
        model, data = self._model, self._data
        mujoco.mj_resetData(model, data)
        model.geom_friction[:] = friction_scale * self._friction
        data.qpos[self._address] = qpos
        if shift_world is not None:
            data.qpos[self._free : self._free + 3] += shift_world
        data.ctrl[:] = qpos[self._driven]
        mujoco.mj_forward(model, data)
        start = self._pose()
        for target in action:
            data.ctrl[:] = target[self._driven]
            for _ in range(_PERIODS):
                before = data.qpos[self._address]
                mujoco.mj_step(model, data, self._steps)
                now = data.qpos[self._address]
                if np.abs(now - target).max() < _ARRIVED or np.abs(now - before).max() < _ARRIVED:
                    break
        mujoco.mj_step(model, data, _AFTER * self._steps)
        end = self._pose()
        finite = bool(np.isfinite(end).all() and not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number)
        return Played(end @ np.linalg.inv(start), self._on_support(), finite)

    def _pose(self) -> Array:
        T = np.eye(4)
        T[:3, 3] = self._data.xpos[self._object]
        T[:3, :3] = self._data.xmat[self._object].reshape(3, 3)
        return T

    def _on_support(self) -> bool:
        of_object = self._model.geom_bodyid == self._object
        return any(_SUPPORT_GEOM in pair and of_object[pair].any() for pair in self._data.contact.geom)
