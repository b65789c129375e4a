"""A damped Newton step inside a box, by an active set at its sides."""

from typing import NamedTuple

import numpy as np

from cei_gym.arrays import Array
from cei_gym.compiled import njit

DAMPING = 1e-3
"""The damping of a frame's first step."""
LARGEST_STEP = 0.5
"""How far a joint moves in one iteration at most, rad or m."""
LEAST_DAMPING = 1e-9
"""However well it goes."""
EASED, STIFFENED = 0.33, 4.0
"""What damping is multiplied by after a step that lowers the objective, and after one that does not."""


class StepMemory(NamedTuple):
    """Scratch: a triangular factor, the solution of the free joints, which are free, and the whole step."""

    factor: Array
    solution: Array
    free: Array
    delta: Array
    fixed: Array


@njit(cache=True, nogil=True)
def empty_step(m):
    return StepMemory(np.empty((m, m)), np.empty(m), np.empty(m, np.int64), np.empty(m), np.empty(m, np.bool_))


@njit(cache=True, nogil=True)
def eased(damping):
    """The damping after a step that has lowered the objective."""
    return max(damping * EASED, LEAST_DAMPING)


@njit(cache=True, nogil=True)
def take_step(hessian, gradient, damping, lower, upper, u, new, memory):
    """Fill `new`; returns how far the quadratic model falls.

    Joints at a side of the box whose gradient pushes outward stay. A joint that the step would carry outside goes to the
    side, and the others are solved again: merely clamping it would leave a step that may not descend at all.
    """
    delta, fixed = memory.delta, memory.fixed
    for k in range(len(u)):
        outward = (u[k] <= lower[k] and gradient[k] > 0) or (u[k] >= upper[k] and gradient[k] < 0)
        fixed[k], delta[k] = outward or hessian[k, k] <= 0.0, 0.0
    for _ in range(len(u)):
        _solve_free(hessian, gradient, damping, memory)
        inside = True
        for k in range(len(u)):
            if not fixed[k] and not lower[k] <= u[k] + delta[k] <= upper[k]:
                fixed[k], inside = True, False
                delta[k] = (lower[k] if delta[k] < 0 else upper[k]) - u[k]
        if inside:
            break
    fall = 0.0
    for k in range(len(u)):
        new[k] = min(max(u[k] + delta[k], lower[k]), upper[k])
        total = gradient[k]
        for l in range(len(u)):
            total += 0.5 * hessian[k, l] * delta[l]
        fall -= delta[k] * total
    return fall


@njit(cache=True, nogil=True)
def _solve_free(hessian, gradient, damping, memory):
    """Solve for the free joints, the steps of the others held.

    Our own Cholesky: at 13 joints it takes a third of the time of numba's call to LAPACK, and allocates nothing.
    """
    L, x, free, delta, fixed = memory
    n = 0
    for k in range(len(delta)):
        if not fixed[k]:
            free[n] = k
            n += 1
    for a in range(n):
        for b in range(a + 1):
            total = hessian[free[a], free[b]] + (damping if a == b else 0.0)
            for c in range(b):
                total -= L[a, c] * L[b, c]
            L[a, b] = np.sqrt(max(total, 1e-12)) if a == b else total / L[b, b]
    for a in range(n):
        total = -gradient[free[a]]
        for k in range(len(delta)):
            if fixed[k]:
                total -= hessian[free[a], k] * delta[k]
        for c in range(a):
            total -= L[a, c] * x[c]
        x[a] = total / L[a, a]
    largest = 0.0
    for a in range(n - 1, -1, -1):
        total = x[a]
        for c in range(a + 1, n):
            total -= L[c, a] * x[c]
        x[a] = total / L[a, a]
        largest = max(largest, abs(x[a]))
    shrink = 1.0 if largest <= LARGEST_STEP else LARGEST_STEP / largest
    for a in range(n):
        delta[free[a]] = shrink * x[a]
