"""Which simulation an embodiment gets."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from cei_envs.simulation import Simulation
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.untrusted import is_pose

_SAME_PLACE_M = 1e-3
_ROBOSUITE = "package://robosuite/"


def simulate(
    embodiment: Embodiment,
    make: Callable[..., Any],
    stock_physics: bool = False,
    T_world_base: Sequence[Sequence[float]] | None = None,
) -> Simulation:
    """Physics for an embodiment: robosuite's own where robosuite can mount it, else composed.

    Args:
        embodiment: arm and end-effector.
        make: builds the task's robosuite environment from its robot arguments.
        stock_physics: apply only the physics exceptions without which nothing works; of those that robosuite mounts.
        T_world_base: (4, 4) where the base stands; default: where robosuite puts it.

    Raises:
        CEIError: the embodiment lacks a part, or robosuite puts it elsewhere.
    """
    place = None if T_world_base is None else _checked(T_world_base)
    if not mountable(embodiment):
        from cei_envs.composed import ComposedSimulation

        return ComposedSimulation(embodiment, make, place)
    from cei_envs.mounted import MountedSimulation

    simulation = MountedSimulation(embodiment, make, stock_physics)
    if place is not None and not np.allclose(place, simulation.T_world_base, atol=_SAME_PLACE_M):
        simulation.close()
        at = ", ".join(f"{x:g}" for x in simulation.T_world_base[:3, 3].round(3))
        raise CEIError(
            f"robosuite stands {embodiment.name} at {at} m, upright; elsewhere (T_world_base, --target_pose) stand only robots that it does not have."
        )
    return simulation


def mountable(embodiment: Embodiment) -> bool:
    """Whether robosuite has both parts of an embodiment: by a name there, and from the very description."""
    parts = (embodiment.arm, embodiment.end_effector)
    return all(
        part is None or (bool(part.simulator_name) and part.description.startswith(_ROBOSUITE)) for part in parts
    )


def _checked(pose: Sequence[Sequence[float]]) -> Array:
    try:
        matrix = np.array(pose, float)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if not is_pose(matrix):
        raise CEIError("T_world_base should be a 4x4 rigid transform [[R, t], [0, 0, 0, 1]].")
    return matrix
