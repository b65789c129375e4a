"""An object of a task that lies somewhere: its pose as numbers, read and restored."""

from dataclasses import dataclass

import mujoco
import numpy as np

from cei_envs.simulation import Simulation, pose_of
from cei_envs.tasks.cube import TABLE_Z_M
from cei_gym.arrays import Array


@dataclass(frozen=True)
class Placed:
    """What an MJCF describes, as part of a task's state.

    Attributes:
        name: of the object.
        free: whether it may be moved; else it is fixed to the table at a place and heading that a start gives.
        description: its MJCF, of one body and as robosuite has its objects: a path, or `package://<Python package>/...`; default:
            `assets/<name>.xml`.
        z_m: height of its origin, world, if it is not free.
    """

    name: str
    free: bool = True
    description: str | None = None
    z_m: float = TABLE_Z_M

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names with units of its part of the state."""
        entries = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz") if self.free else ("x_m", "y_m", "yaw_rad")
        return tuple(f"{self.name}.{entry}" for entry in entries)

    def at(self, x_m: float, y_m: float, yaw_rad: float, z_m: float = TABLE_Z_M) -> Array:
        """(7,) or (3,) state of it where its origin is at x, y and, if it is free, z, turned about the vertical."""
        if not self.free:
            return np.array([x_m, y_m, yaw_rad])
        return np.array([x_m, y_m, z_m, np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])

    def read(self, simulation: Simulation) -> Array:
        """Its part of the state now."""
        body = simulation.model.body(self._body)
        if self.free:
            return simulation.data.qpos[self._qpos(simulation.model)].copy()
        return np.array([*body.pos[:2], 2 * np.arctan2(body.quat[3], body.quat[0])])

    def apply(self, simulation: Simulation, state: Array) -> None:
        """Take its part of a state."""
        if self.free:
            simulation.data.qpos[self._qpos(simulation.model)] = state
            return
        body, (x_m, y_m, yaw_rad) = simulation.model.body(self._body), state
        body.pos[:] = [x_m, y_m, self.z_m]
        body.quat[:] = [np.cos(yaw_rad / 2), 0, 0, np.sin(yaw_rad / 2)]

    def T_world(self, simulation: Simulation) -> Array:
        """(4, 4) pose of its frame."""
        return pose_of(simulation.data, self._body)

    def geoms(self, simulation: Simulation) -> Array:
        """Its geoms, of all its bodies."""
        model = simulation.model
        root = model.body(self._body).id
        return np.flatnonzero(model.body_rootid[model.geom_bodyid] == root)

    @property
    def _body(self) -> str:
        return f"{self.name}_main"

    def _qpos(self, model: mujoco.MjModel) -> slice:
        address = model.jnt_qposadr[model.body(self._body).jntadr[0]]
        return slice(address, address + 7)
