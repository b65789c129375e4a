"""A free cube of a robosuite task: its state as numbers, read and restored."""

import mujoco
import numpy as np

from cei_gym.arrays import Array

STATE_SIZE = 11
TABLE_Z_M = 0.8
DENSITY_KG_M3 = 1000.0


def state_names(cube: str) -> tuple[str, ...]:
    """Names with units of a cube's state."""
    pose = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
    return tuple(f"{cube}.{name}" for name in (*pose, "half_x_m", "half_y_m", "half_z_m", "mass_kg"))


def cube_on_table(x_m: float, y_m: float, yaw_rad: float, half_m: Array) -> Array:
    """(11,) state of a cube with half sizes `half_m` (3,) that lies on the table."""
    quat_wxyz = [np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)]
    return np.array([x_m, y_m, TABLE_Z_M + half_m[2], *quat_wxyz, *half_m, DENSITY_KG_M3 * 8 * np.prod(half_m)])


class Cube:
    """One cube in a model.

    Args:
        model: the simulation's.
        data: the simulation's.
        body: the cube's body; its one joint is free and its geoms are boxes of one size.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, body: str) -> None:
        self._model, self._data = model, data
        self._body = model.body(body).id
        self.geoms = np.flatnonzero(model.geom_bodyid == self._body)
        address = model.jnt_qposadr[model.body_jntadr[self._body]]
        self._qpos = slice(address, address + 7)

    @property
    def position_world(self) -> Array:
        """(3,) centre, m."""
        return self._data.xpos[self._body].copy()

    @property
    def half_height_m(self) -> float:
        return float(self._model.geom_size[self.geoms[0], 2])

    def read(self) -> Array:
        """(11,) state now."""
        size, mass = self._model.geom_size[self.geoms[0]], self._model.body_mass[self._body]
        return np.array([*self._data.qpos[self._qpos], *size, mass])

    def apply(self, state: Array) -> None:
        """Take a state (11,)."""
        model, data, half, mass = self._model, self._data, state[7:10], state[10]
        model.geom_size[self.geoms] = half
        model.geom_rbound[self.geoms] = np.linalg.norm(half)
        model.geom_aabb[self.geoms] = [0, 0, 0, *half]
        model.body_mass[self._body] = mass
        model.body_inertia[self._body] = mass / 3 * (np.square(half).sum() - np.square(half))
        saved = data.qpos.copy()
        mujoco.mj_setConst(model, data)  # also brings the first state back
        data.qpos[:] = saved
        data.qpos[self._qpos] = state[:7]
