"""A simulation of one embodiment among a task's objects, read and driven in the embodiment's own joint layout."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.environment import Physics

CONTROL_HZ = 20


class Simulation(ABC):
    """Physics around one embodiment; `mounted` and `composed` are the two ways of making one.

    Args:
        model, data: MuJoCo's.
        joints: of the model, one for each of the embodiment's.
        driven: indices into the embodiment's joints that targets move, as its actuators have them.
        prefixes: of the names of the robot's bodies.
        T_world_base: (4, 4) pose of its base, which stands still.
        physics: by which rules it treats the robot.

    Attributes:
        model, data, driven, T_world_base, physics: as given.
        robot_geoms: geoms of arm and end-effector.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        joints: Sequence[int],
        driven: Array,
        prefixes: tuple[str, ...],
        T_world_base: Array,
        physics: Physics,
    ) -> None:
        self.model, self.data, self.driven, self.T_world_base = model, data, driven, T_world_base
        self.physics = physics
        self._friction = model.geom_friction.copy(), model.pair_friction.copy()
        self._qpos_address = model.jnt_qposadr[joints]
        self._qvel_address = model.jnt_dofadr[joints]
        owner = [model.body(b).name for b in model.geom_bodyid]
        self.robot_geoms = np.flatnonzero([name.startswith(prefixes) for name in owner])

    @property
    def qpos(self) -> Array:
        """(n,) joint positions of arm, then end-effector, rad or m."""
        return self.data.qpos[self._qpos_address].copy()

    @property
    @abstractmethod
    def wrench(self) -> Array:
        """(6,) force, N, and torque, N m, between arm and end-effector."""

    @abstractmethod
    def reset(self, qpos: Array) -> None:
        """Bring everything to its first state, with the robot at rest at `qpos` (n,)."""

    @abstractmethod
    def forward(self) -> None:
        """Recompute everything that follows from the state, after a change to it."""

    @abstractmethod
    def tick(self, target: Array) -> None:
        """One control period towards absolute joint targets (n,), rad or m."""

    @abstractmethod
    def close(self) -> None:
        """Free the simulation."""

    def scale_friction(self, factor: float) -> None:
        """Make all friction what was described, times a factor."""
        self.model.geom_friction[:], self.model.pair_friction[:] = (factor * each for each in self._friction)

    def touching(self, geoms: Array, others: Array) -> bool:
        """Whether any of the geoms touches any of the others."""
        one, two = self.data.contact.geom.T
        return bool(np.any((np.isin(one, geoms) & np.isin(two, others)) | (np.isin(two, geoms) & np.isin(one, others))))

    def _place(self, qpos: Array) -> None:
        self.data.qpos[self._qpos_address] = qpos
        self.data.qvel[self._qvel_address] = 0.0


def pose_of(data: mujoco.MjData, body: str) -> Array:
    """(4, 4) pose of a body in the world."""
    place, T_world_body = data.body(body), np.eye(4)
    T_world_body[:3, 3] = place.xpos
    T_world_body[:3, :3] = place.xmat.reshape(3, 3)
    return T_world_body
