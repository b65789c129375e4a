"""A damped Newton step inside a box, by an active set at its sides."""

from typing import NamedTuple

import numpy as np
from numba import njit

_LARGEST_STEP = 0.5  # rad or m a joint and iteration
_FAST = {"contract", "arcp", "nsz", "reassoc"}


class StepMemory(NamedTuple):
    """Scratch: a triangular factor, a right-hand side, and which joints are free."""

    factor: np.ndarray
    delta: np.ndarray
    free: np.ndarray


@njit(cache=True, nogil=True)
def empty_step(m):
    return StepMemory(np.empty((m, m)), np.empty(m), np.empty(m, np.int64))


@njit(cache=True, nogil=True, fastmath=_FAST)
def take_step(hessian, gradient, damping, lower, upper, u, new, memory):
    """Fill `new`; returns how far the quadratic model falls.

    Joints at a side of the box whose gradient pushes outward stay. Our own Cholesky: at 20 joints it takes a tenth of
    the time of a call to LAPACK.
    """
    L, delta, free = memory
    n = 0
    for k in range(len(u)):
        out = (u[k] <= lower[k] and gradient[k] > 0) or (u[k] >= upper[k] and gradient[k] < 0)
        if not out and hessian[k, k] > 0.0:
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
        for c in range(a):
            total -= L[a, c] * delta[c]
        delta[a] = total / L[a, a]
    largest = 0.0
    for a in range(n - 1, -1, -1):
        total = delta[a]
        for c in range(a + 1, n):
            total -= L[c, a] * delta[c]
        delta[a] = total / L[a, a]
        largest = max(largest, abs(delta[a]))
    shrink = 1.0 if largest <= _LARGEST_STEP else _LARGEST_STEP / largest
    new[:] = u
    for a in range(n):
        k = free[a]
        new[k] = min(max(u[k] + shrink * delta[a], lower[k]), upper[k])
        delta[a] = new[k] - u[k]
    fall = 0.0
    for a in range(n):
        total = gradient[free[a]]
        for b in range(n):
            total += 0.5 * hessian[free[a], free[b]] * delta[b]
        fall -= delta[a] * total
    return fall
