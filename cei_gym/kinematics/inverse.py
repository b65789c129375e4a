"""Inverse kinematics of a trajectory of one link, by mink."""

from copy import copy
from typing import NamedTuple

import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.embodiment import Embodiment

_STARTS = 8
_SPREAD_RAD = 0.7
_ITERATIONS = 50
_CONVERGED_RAD = 1e-6
_REACHED = 1e-3  # m and rad


class Followed(NamedTuple):
    """Joints that bring a link along a trajectory, as near as limits let it.

    Attributes:
        qpos: (T, n) rad or m.
        position_m, angle_rad: (T,) how far off the link is.
    """

    qpos: Array
    position_m: Array
    angle_rad: Array

    @property
    def error(self) -> Array:
        """(T,) both in one, m and rad."""
        return np.hypot(self.position_m, self.angle_rad)


def follow_link(embodiment: Embodiment, link: int, T_base_link: Array) -> Followed:
    """Follow a trajectory with a link that the arm carries, from the start that does it best.

    Frame 0 starts from the home pose, or from one around it where the trajectory cannot be followed from there; the others each from
    the last. Joints that do not move the link stay at home.

    Args:
        embodiment: the robot.
        link: index of the link.
        T_base_link: (T, 4, 4) where it should be, in the base frame.
    """
    rng = np.random.default_rng(0)
    spread = _SPREAD_RAD * (np.arange(len(embodiment.home)) < embodiment.n_arm)
    found = []
    for attempt in range(_STARTS):
        start = embodiment.home + (attempt > 0) * spread * rng.standard_normal(len(spread))
        found.append(_follow_from(embodiment, np.clip(start, embodiment.lower, embodiment.upper), link, T_base_link))
        if found[-1].error.max() < _REACHED:
            break
    return min(found, key=lambda followed: followed.error.mean())


def _follow_from(embodiment: Embodiment, start: Array, link: int, T_base_link: Array) -> Followed:
    import mink  # takes half a second to import

    model = copy(embodiment.model)  # with the embodiment's limits, which may be tighter than the description's
    model.jnt_limited[:], model.jnt_range[:] = 1, np.stack([embodiment.lower, embodiment.upper], axis=1)
    configuration, limits = mink.Configuration(model, start), [mink.ConfigurationLimit(model)]
    task = mink.FrameTask(model.body(link).name, "body", position_cost=1.0, orientation_cost=0.5, lm_damping=1.0)
    qpos, errors = [], []
    for T in T_base_link:
        task.set_target(mink.SE3.from_matrix(T))
        for _ in range(_ITERATIONS):
            step = mink.solve_ik(configuration, [task], 1.0, "daqp", damping=1e-9, limits=limits)
            configuration.integrate_inplace(step, 1.0)
            if np.abs(step).max() < _CONVERGED_RAD:
                break
        qpos.append(configuration.q.copy())
        errors.append(task.compute_error(configuration))
    position_m, angle_rad = np.linalg.norm(np.reshape(errors, (-1, 2, 3)), axis=2).T
    return Followed(np.array(qpos), position_m, angle_rad)
