"""One frame of the alignment: Levenberg-Marquardt from where the frame before ended, inside joint and velocity limits.

A step is kept only if the true objective falls, matches renewed.
"""

from typing import NamedTuple

import numpy as np

from cei_gym.alignment.kernels.collision import penalise
from cei_gym.alignment.kernels.distance import evaluate
from cei_gym.alignment.kernels.quadratic import Quadratic, add_distance, empty_quadratic, project
from cei_gym.alignment.kernels.step import DAMPING, STIFFENED, StepMemory, eased, empty_step, take_step
from cei_gym.alignment.kernels.target import Pose, Source, empty_pose, empty_source, load_source
from cei_gym.arrays import Array
from cei_gym.compiled import njit

DAMPING_TRIES = 8
"""How often a step is tried, each time stiffer, before the frame counts as solved."""


class Settings(NamedTuple):
    """What `SolverOptions` says, for compiled code (see there)."""

    lambda_m: float
    temporal_weight: float
    smoothness_weight: float
    tolerance: float
    iterations: int


class Memory(NamedTuple):
    """Scratch of one trajectory, so that frames allocate nothing."""

    source: Source
    pose: Pose
    trial: Pose
    quadratic: Quadratic
    step: StepMemory
    anchor: Array
    lower: Array
    upper: Array
    new: Array


@njit(cache=True, nogil=True)
def empty_memory(target, n_source):
    m = len(target.lower)
    return Memory(
        empty_source(n_source),
        empty_pose(target, n_source),
        empty_pose(target, n_source),
        empty_quadratic(target),
        empty_step(m),
        np.empty(m),
        np.empty(m),
        np.empty(m),
        np.empty(m),
    )


@njit(cache=True, nogil=True)
def _near(u, anchor, weight):
    total = 0.0
    for k in range(len(u)):
        total += (u[k] - anchor[k]) ** 2
    return 0.5 * weight * total


@njit(cache=True, nogil=True)
def _objective(target, source, settings, collision, obstacles, weight, anchor, u, pose, quadratic):
    """DCD, and with it what the other terms add, at u."""
    dcd = evaluate(target, source, settings.lambda_m, u, pose)
    extra = _near(u, anchor, weight)
    if collision.weight > 0.0:
        extra += penalise(collision, obstacles, source.origin, pose, quadratic, False)
    return dcd, dcd + extra


@njit(cache=True, nogil=True)
def solve_frame(target, points, normals, settings, collision, obstacles, dt_s, last, before, memory, u):
    """Solve one frame into u (m,), which holds a start inside the limits.

    Args:
        last, before: (m,) solutions of the last frame and the one before it; `dt_s < 0` says that there are none.
        dt_s: time since the last frame; 0 leaves speeds unlimited.

    Returns:
        DCD, iterations spent.
    """
    source, pose, trial, quadratic = memory.source, memory.pose, memory.trial, memory.quadratic
    anchor, lower, upper, new = memory.anchor, memory.lower, memory.upper, memory.new
    load_source(points, normals, source)
    weight = 0.0
    for k in range(len(u)):
        lower[k], upper[k], anchor[k] = target.lower[k], target.upper[k], u[k]
    if dt_s >= 0.0:
        weight = settings.temporal_weight + settings.smoothness_weight
        lean = settings.smoothness_weight / weight if weight > 0.0 else 0.0
        for k in range(len(u)):
            # both quadratics, one about the last solution and one about its continuation, are one about this
            anchor[k] = last[k] + lean * (last[k] - before[k])
            if dt_s > 0.0:
                lower[k] = max(lower[k], last[k] - target.fastest[k] * dt_s)
                upper[k] = min(upper[k], last[k] + target.fastest[k] * dt_s)
    dcd, objective = _objective(target, source, settings, collision, obstacles, weight, anchor, u, pose, quadratic)
    if dt_s >= 0.0:
        # Motion goes on: start from its continuation where that is better.
        for k in range(len(u)):
            new[k] = min(max(2.0 * last[k] - before[k], lower[k]), upper[k])
        dcd_new, objective_new = _objective(
            target, source, settings, collision, obstacles, weight, anchor, new, trial, quadratic
        )
        if objective_new < objective:
            u[:] = new
            dcd, objective = dcd_new, objective_new
            pose, trial = trial, pose
    damping, flat, spent = DAMPING, 0, 0
    while spent < settings.iterations and flat < 2:
        spent += 1
        add_distance(target, source, settings.lambda_m, pose, quadratic)
        if collision.weight > 0.0:
            penalise(collision, obstacles, source.origin, pose, quadratic, True)
        project(target, source.origin, pose, quadratic)
        gradient, hessian = quadratic.gradient, quadratic.hessian
        for k in range(len(u)):
            gradient[k] += weight * (u[k] - anchor[k])
            hessian[k, k] += weight
        accepted = False
        for _ in range(DAMPING_TRIES):
            fall = take_step(hessian, gradient, damping, lower, upper, u, new, memory.step)
            if 0.0 <= fall < settings.tolerance:
                break
            dcd_new, objective_new = _objective(
                target, source, settings, collision, obstacles, weight, anchor, new, trial, quadratic
            )
            if objective_new < objective:
                flat = flat + 1 if objective - objective_new < settings.tolerance else 0
                u[:] = new
                dcd, objective, accepted = dcd_new, objective_new, True
                pose, trial = trial, pose
                damping = eased(damping)
                break
            damping *= STIFFENED
        if not accepted:
            break
    return dcd, spent
