"""Joints of an arm from poses of one of its links."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cei_gym.kinematics.tree import KinematicTree

_M_PER_RAD = 0.2  # how much an angle weighs: what it moves at a hand's distance
_STARTS = 24
_REACHED = 1e-6


class Recovered(NamedTuple):
    """Joints that put a link where it is wanted, as near as they can.

    Attributes:
        qpos: (T, n) rad or m.
        position_m, angle_rad: (T,) how far off the link is.
    """

    qpos: np.ndarray
    position_m: np.ndarray
    angle_rad: np.ndarray


def recover_arm(tree: KinematicTree, T_base_link: np.ndarray, link: int, qpos: np.ndarray, seed: int = 0) -> Recovered:
    """Solve for the arm's joints frame by frame, each from the last; the first from home and, where that fails, from elsewhere.

    Args:
        tree: of the embodiment.
        T_base_link: (T, 4, 4) wanted poses, in the base frame.
        link: index of the link.
        qpos: (T, n) joints; those of the end-effector stay.
        seed: of the starts.
    """
    body = tree.embodiment
    n, lower, upper = body.n_arm, body.lower[: body.n_arm], body.upper[: body.n_arm]
    qpos = qpos.copy()
    starts: Sequence[np.ndarray] = (body.home[:n], *np.random.default_rng(seed).uniform(lower, upper, (_STARTS, n)))
    errors = np.empty((len(qpos), 6))
    for t, T in enumerate(T_base_link):
        if t > 0:
            starts = (qpos[t - 1, :n],)
        best = np.inf
        for start in starts:
            found = _solve(tree, T, link, qpos[t], np.clip(start, lower, upper))
            if found.cost < best:
                best, qpos[t, :n], errors[t] = found.cost, found.x, found.fun
            if best < _REACHED**2:
                break
    return Recovered(qpos, np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1) / _M_PER_RAD)


def _solve(tree: KinematicTree, T: np.ndarray, link: int, qpos: np.ndarray, start: np.ndarray):
    n = len(start)
    wanted, full = Rotation.from_matrix(T[:3, :3]), qpos.copy()
    weights = np.repeat([1.0, _M_PER_RAD], 3)

    def at(arm: np.ndarray) -> np.ndarray:
        full[:n] = arm
        return full

    def error(arm: np.ndarray) -> np.ndarray:
        now = tree.forward(at(arm))[link]
        angle = (Rotation.from_matrix(now[:3, :3]) * wanted.inv()).as_rotvec()
        return np.concatenate([now[:3, 3] - T[:3, 3], angle]) * weights

    def slope(arm: np.ndarray) -> np.ndarray:  # exact where the angle is 0
        return tree.jacobian(at(arm), link, np.zeros(3))[:, :n] * weights[:, None]

    options = {"xtol": 1e-10, "ftol": 1e-12, "gtol": 1e-12, "max_nfev": 100}
    bounds = (tree.embodiment.lower[:n], tree.embodiment.upper[:n])
    return least_squares(error, start, slope, bounds, **options)  # pyright: ignore[reportArgumentType]
