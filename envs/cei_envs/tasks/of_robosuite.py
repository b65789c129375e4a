"""What robosuite's own tasks share: episodes that robosuite stored are taken up where they began."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.environment import CEIEnv
from cei_envs.tasks.stored_model import StoredModel
from cei_gym.arrays import Array
from cei_gym.environment import Restored
from cei_gym.errors import CEIError

_SAME_M = 1e-3


class OfRobosuite(CEIEnv, ABC):
    """A task that robosuite has by the same name."""

    fixtures: ClassVar[Mapping[str, tuple[float, float, float]]]
    """Bodies that stand still, and where robosuite has them, m: by what a stored model is known to be of this scene."""

    surface_z_m: ClassVar[float]
    """Height of what objects start on."""

    @classmethod
    def restore(cls, mjcf: str, states: Array) -> Restored:
        """An episode as robosuite's simulator stored it; see `cei_gym.environment.Restores`."""
        model = StoredModel(mjcf)
        for body, place in cls.fixtures.items():
            there = model.place(body)[:3]
            if not np.allclose(there, place, atol=_SAME_M):
                says = ", ".join(f"{x:g}" for x in there)
                raise CEIError(
                    f"{body} is at {says} m in the stored model, but at {', '.join(map(str, place))} m in {cls.task}."
                )
        base, T_world_base = model.place("robot0_base"), np.eye(4)
        T_world_base[:3, :3] = Rotation.from_quat(base[3:], scalar_first=True).as_matrix()
        T_world_base[:3, 3] = base[:3]
        state = cls.stored_state(model, np.asarray(states, float))
        if not np.isfinite(state).all():
            raise CEIError("the stored states have numbers that are not finite.")
        return Restored(state, T_world_base, cls.surface_z_m)

    @classmethod
    @abstractmethod
    def stored_state(cls, model: StoredModel, states: Array) -> Array:
        """(T, k) `environment_state` from states (T, ...) of a stored model.

        Raises:
            CEIError: they have not all of it.
        """


def stored_cube(name: str, model: StoredModel, states: Array) -> Array:
    """(T, 11) state of a cube, as `cei_envs.tasks.cube` has it."""
    pose = model.joint(f"{name}_joint0", states)
    return np.column_stack([pose, np.tile(model.box(f"{name}_g0"), (len(pose), 1))])
