"""Where frame 0 starts: many random starts, few distinct basins, and the one whose whole trajectory is best.

Basins within a millimetre of each other in objective can put a hand into its own forearm or under the table, which shows
only later in the episode, so candidates are judged by tracking whole demonstrations.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from cei_gym.alignment.clearance import Clearance
from cei_gym.alignment.newton import NewtonSolver
from cei_gym.alignment.problem import AlignmentProblem, SolverOptions, Track

_SAME_BASIN_RAD = 0.15
_PENETRATION_WEIGHT = 1.0  # metres of objective a metre of penetration
_TORQUE_WEIGHT = 0.05  # metres of objective for static torque a full limit above the allowed share
_TORQUE_SHARE = 0.8
_JUMP_WEIGHT = 0.05  # metres of objective a radian above the allowed step
_JUMP_RAD = 0.25
_CHECKED_FRAMES = 20  # of each demonstration, for penetration and torque


@dataclass(frozen=True)
class InitialisationOptions:
    """Options of the multi-start.

    Attributes:
        starts: random starts on frame 0.
        iterations: most iterations a start.
        basins: distinct basins that are judged on whole demonstrations.
        seed: of the random starts.
    """

    starts: int = 256
    iterations: int = 20
    basins: int = 32
    seed: int = 0


@dataclass(frozen=True)
class Basin:
    """A frame-0 solution and what following it through a demonstration costs.

    Attributes:
        u: (m,) independent joints at frame 0, rad or m.
        cost: metres; mean objective plus penalties (lower is better).
        objective: metres; mean DCD over the demonstration.
        penetration_m: deepest contact of the target with itself, the support surface or its stand.
        torque_share: largest static joint torque as a share of its limit.
        joint_step_rad: largest joint step between frames.
    """

    u: np.ndarray
    cost: float
    objective: float
    penetration_m: float
    torque_share: float
    joint_step_rad: float


def active_joints(problem: AlignmentProblem) -> np.ndarray:
    """(m,) which independent joints move a pad at all; the others keep their home position."""
    arrays, coupled = problem.tree.arrays, problem.embodiment.coupled
    active = np.zeros(len(coupled.independent), bool)
    for body in np.unique(problem.representation.body):
        joint = arrays.body_joint[body]
        while joint >= 0:
            active[coupled.leader[joint]] = True
            joint = arrays.joint_parent[joint]
    return active


def random_starts(problem: AlignmentProblem, n: int, seed: int) -> np.ndarray:
    """(n, m) independent joints, uniform within limits and within pi of home, so that no joint starts wrapped."""
    lower, upper = problem.embodiment.independent_limits
    home = problem.embodiment.coupled.reduce(problem.embodiment.home)
    lower, upper = np.maximum(lower, home - np.pi), np.minimum(upper, home + np.pi)
    u = np.random.default_rng(seed).uniform(lower, upper, (n, len(home)))
    return np.where(active_joints(problem), u, home)


def find_basins(
    problem: AlignmentProblem,
    solver: SolverOptions,
    points_base,
    normals_base,
    options: InitialisationOptions,
) -> np.ndarray:
    """Distinct frame-0 solutions, best first.

    Args:
        points_base, normals_base: (N, 3) the source's representation at frame 0, target's base frame.

    Returns:
        (K, m) with K <= options.basins.
    """
    newton = NewtonSolver(problem, solver)
    points, normals = points_base[None], normals_base[None]

    def solve(u0, iterations: int) -> Track:
        return newton.track(points, normals, u0, iterations)

    starts = random_starts(problem, options.starts, options.seed)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        tracks = list(pool.map(lambda u0: solve(u0, options.iterations), starts))
    order = np.argsort([t.objective[0] for t in tracks], kind="stable")
    kept: list[np.ndarray] = []
    for i in order:
        u = solve(tracks[i].u[0], 200).u[0]
        if all(np.abs(u - other).max() > _SAME_BASIN_RAD for other in kept):
            kept.append(u)
        if len(kept) == options.basins:
            break
    return np.array(kept)


def judge_basins(
    problem: AlignmentProblem,
    solver: SolverOptions,
    trajectories: Sequence[tuple[np.ndarray, np.ndarray]],
    basins: np.ndarray,
    support_z_base_m: float,
) -> list[Basin]:
    """Follow each basin through whole demonstrations; best first.

    Args:
        trajectories: points and normals (T, N, 3) of each demonstration, target's base frame.
        basins: (K, m) frame-0 solutions.
        support_z_base_m: height of the support surface in the target's base frame.
    """
    newton = NewtonSolver(problem, solver)
    clearance = Clearance(problem.embodiment, support_z_base_m)

    def judge(u0: np.ndarray) -> Basin:
        tracks = [newton.track(points, normals, u0) for points, normals in trajectories]
        seen = np.concatenate([t.u[:: max(1, len(t.u) // _CHECKED_FRAMES)] for t in tracks])
        objective = float(np.mean(np.concatenate([t.objective for t in tracks])))
        step = max(float(np.abs(np.diff(t.u, axis=0)).max(initial=0.0)) for t in tracks)
        penetration, torque = clearance.worst(problem.embodiment.coupled.expand(seen))
        cost = objective + _PENETRATION_WEIGHT * penetration
        cost += _TORQUE_WEIGHT * max(0.0, torque - _TORQUE_SHARE) + _JUMP_WEIGHT * max(0.0, step - _JUMP_RAD)
        return Basin(u0, cost, objective, penetration, torque, step)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return sorted(pool.map(judge, basins), key=lambda b: b.cost)
