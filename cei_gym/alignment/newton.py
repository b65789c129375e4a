"""A second-order solver for the alignment: Levenberg-Marquardt on a majoriser of the DCD, compiled.

With the matches held, `|r| <= |r|^2 / (2 d) + d / 2` with `d = sqrt(|r|^2 + eps^2)`, and `-lambda n.n' =
(lambda / 2)|n - n'|^2 - lambda`: a sum of squares that touches the DCD from above. Its gradient and Hessian are summed as
6-vectors and 6x6 blocks a link, carried from leaf to root, and projected on the joints' screws, as composite rigid bodies
are, so no dense Jacobian is formed. A step is kept only if the true objective falls. Joints at a limit whose gradient
pushes outward are left out of the step, so limits hold at every frame by construction.

Our own because no library minimises a Chamfer distance over a kinematic tree to second order.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from cei_gym.alignment.problem import AlignmentProblem, SolverOptions, Track
from cei_gym.kinematics.tree import TreeArrays, forward_into

_SMOOTHING_M = 1e-3
_LARGEST_STEP = 0.5  # rad or m a joint and iteration
_DAMPING_TRIES = 8


class Target(NamedTuple):
    """The target as arrays for compiled code (see `TreeArrays`, `FunctionalRepresentation`, `Coupled`)."""

    tree: TreeArrays
    body: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    leader: np.ndarray
    scale: np.ndarray
    offset: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class Buffers(NamedTuple):
    """Scratch memory of one evaluation."""

    qpos: np.ndarray
    rot: np.ndarray
    pos: np.ndarray
    axis: np.ndarray
    anchor: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    match: np.ndarray  # (N,) target pair of each source pair
    match_back: np.ndarray  # (N',) source pair of each target pair
    best: np.ndarray
    best_back: np.ndarray


@njit(cache=True, nogil=True)
def _buffers(target, n_source):
    links, joints, n = len(target.tree.parent), len(target.tree.hinge), len(target.body)
    return Buffers(
        np.empty(joints),
        np.empty((links, 3, 3)),
        np.empty((links, 3)),
        np.empty((joints, 3)),
        np.empty((joints, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty(n_source, np.int64),
        np.empty(n, np.int64),
        np.empty(n_source),
        np.empty(n),
    )


@njit(cache=True, nogil=True, fastmath={"contract", "arcp", "nsz", "reassoc"})
def _evaluate(target, points, normals, lambda_m, u, out):
    """DCD at u; fills `out` with poses, placed pads and matches."""
    for q in range(len(out.qpos)):
        out.qpos[q] = u[target.leader[q]] * target.scale[q] + target.offset[q]
    forward_into(target.tree, out.qpos, out.rot, out.pos, out.axis, out.anchor)
    for j in range(len(target.body)):
        R, t = out.rot[target.body[j]], out.pos[target.body[j]]
        for i in range(3):
            out.points[j, i] = t[i]
            out.normals[j, i] = 0.0
            for k in range(3):
                out.points[j, i] += R[i, k] * target.points[j, k]
                out.normals[j, i] += R[i, k] * target.normals[j, k]
    out.best[:] = np.inf
    out.best_back[:] = np.inf
    for i in range(len(points)):
        px, py, pz = points[i]
        nx, ny, nz = normals[i]
        best, where = np.inf, 0
        for j in range(len(out.points)):
            dx, dy, dz = out.points[j, 0] - px, out.points[j, 1] - py, out.points[j, 2] - pz
            cosine = nx * out.normals[j, 0] + ny * out.normals[j, 1] + nz * out.normals[j, 2]
            cost = np.sqrt(dx * dx + dy * dy + dz * dz) - lambda_m * cosine
            if cost < best:
                best, where = cost, j
            if cost < out.best_back[j]:
                out.best_back[j], out.match_back[j] = cost, i
        out.best[i], out.match[i] = best, where
    return out.best.mean() + out.best_back.mean()


@njit(cache=True, nogil=True)
def _add_match(force, block, j, source_point, source_normal, weight, lambda_m, origin, out, joint):
    """Add one match's gradient (6) and Gauss-Newton block (6, 6), linear then angular, about `origin`."""
    r = np.empty(3)
    b = np.empty(3)
    squared = 0.0
    for i in range(3):
        r[i] = out.points[j, i] - source_point[i]
        b[i] = out.points[j, i] - origin[i]
        squared += r[i] * r[i]
    pull = weight / np.sqrt(squared + _SMOOTHING_M * _SMOOTHING_M)
    turn = weight * lambda_m
    n = out.normals[j]
    m = source_normal
    f = force[joint]
    H = block[joint]
    f[0] += pull * r[0]
    f[1] += pull * r[1]
    f[2] += pull * r[2]
    f[3] += pull * (b[1] * r[2] - b[2] * r[1]) - turn * (n[1] * m[2] - n[2] * m[1])
    f[4] += pull * (b[2] * r[0] - b[0] * r[2]) - turn * (n[2] * m[0] - n[0] * m[2])
    f[5] += pull * (b[0] * r[1] - b[1] * r[0]) - turn * (n[0] * m[1] - n[1] * m[0])
    bb = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    for i in range(3):
        H[i, i] += pull
        for k in range(3):
            H[3 + i, 3 + k] += pull * ((bb if i == k else 0.0) - b[i] * b[k])
            H[3 + i, 3 + k] += turn * ((1.0 if i == k else 0.0) - n[i] * n[k])
    # J = [I, -[b]x]: the off-diagonal block is -[b]x
    H[0, 4] += pull * b[2]
    H[0, 5] -= pull * b[1]
    H[1, 3] -= pull * b[2]
    H[1, 5] += pull * b[0]
    H[2, 3] += pull * b[1]
    H[2, 4] -= pull * b[0]


@njit(cache=True, nogil=True)
def _derivatives(target, points, normals, lambda_m, out):
    """Gradient (m,) and majoriser's Hessian (m, m) of the DCD with the matches in `out` held."""
    tree, joints = target.tree, len(target.tree.hinge)
    origin = np.zeros(3)
    for i in range(3):
        origin[i] = points[:, i].mean()
    force, block = np.zeros((joints, 6)), np.zeros((joints, 6, 6))
    for i in range(len(points)):
        j = out.match[i]
        joint = tree.body_joint[target.body[j]]
        if joint >= 0:
            _add_match(force, block, j, points[i], normals[i], 1.0 / len(points), lambda_m, origin, out, joint)
    for j in range(len(target.body)):
        i = out.match_back[j]
        joint = tree.body_joint[target.body[j]]
        if joint >= 0:
            _add_match(force, block, j, points[i], normals[i], 1.0 / len(target.body), lambda_m, origin, out, joint)
    gradient, hessian = np.zeros(len(target.lower)), np.zeros((len(target.lower), len(target.lower)))
    screw = np.zeros((joints, 6))
    for k in range(joints):
        a = out.axis[k]
        if tree.hinge[k]:
            c = origin - out.anchor[k]
            screw[k, 0] = a[1] * c[2] - a[2] * c[1]
            screw[k, 1] = a[2] * c[0] - a[0] * c[2]
            screw[k, 2] = a[0] * c[1] - a[1] * c[0]
            screw[k, 3:] = a
        else:
            screw[k, :3] = a
    column = np.zeros(6)
    for k in range(joints - 1, -1, -1):
        H = block[k]
        for i in range(3):
            for l in range(3):
                H[3 + l, i] = H[i, 3 + l]
        for i in range(6):
            column[i] = 0.0
            for l in range(6):
                column[i] += H[i, l] * screw[k, l]
        u, scale = target.leader[k], target.scale[k]
        total = 0.0
        for i in range(6):
            total += screw[k, i] * force[k, i]
        gradient[u] += scale * total
        other = k
        while other >= 0:
            v = target.leader[other]
            total = 0.0
            for i in range(6):
                total += screw[other, i] * column[i]
            total *= scale * target.scale[other]
            hessian[u, v] += total
            if other != k:
                hessian[v, u] += total
            other = tree.joint_parent[other]
        parent = tree.joint_parent[k]
        if parent >= 0:
            for i in range(6):
                force[parent, i] += force[k, i]
                for l in range(6):
                    block[parent, i, l] += H[i, l]
    return gradient, hessian


@njit(cache=True, nogil=True)
def _step(hessian, gradient, damping, lower, upper, u):
    """Damped Newton step with an active set at the limits, capped and clamped; the new u."""
    free = np.ones(len(u), np.bool_)
    for k in range(len(u)):
        pushed_out = (u[k] <= lower[k] and gradient[k] > 0) or (u[k] >= upper[k] and gradient[k] < 0)
        free[k] = not pushed_out
    index = np.flatnonzero(free)
    H, g = np.empty((len(index), len(index))), np.empty(len(index))
    for a in range(len(index)):
        g[a] = -gradient[index[a]]
        for b in range(len(index)):
            H[a, b] = hessian[index[a], index[b]]
        H[a, a] += damping
    delta = np.linalg.solve(H, g)
    largest = 0.0
    for a in range(len(index)):
        largest = max(largest, abs(delta[a]))
    shrink = 1.0 if largest <= _LARGEST_STEP else _LARGEST_STEP / largest
    new = u.copy()
    for a in range(len(index)):
        k = index[a]
        new[k] = min(max(u[k] + shrink * delta[a], lower[k]), upper[k])
    return new


@njit(cache=True, nogil=True)
def _solve_frame(target, points, normals, lambda_m, temporal, tolerance, iterations, anchor, u, out, trial):
    """Minimise DCD + (temporal / 2)|u - anchor|^2 from u; returns u, DCD and iterations spent."""
    dcd = _evaluate(target, points, normals, lambda_m, u, out)
    objective = dcd + 0.5 * temporal * np.sum((u - anchor) ** 2)
    damping, flat, spent = 1e-3, 0, 0
    while spent < iterations and flat < 2:
        spent += 1
        gradient, hessian = _derivatives(target, points, normals, lambda_m, out)
        for k in range(len(u)):
            gradient[k] += temporal * (u[k] - anchor[k])
            hessian[k, k] += temporal
        accepted, fall = False, 0.0
        for _ in range(_DAMPING_TRIES):
            new = _step(hessian, gradient, damping, target.lower, target.upper, u)
            dcd_new = _evaluate(target, points, normals, lambda_m, new, trial)
            objective_new = dcd_new + 0.5 * temporal * np.sum((new - anchor) ** 2)
            if objective_new < objective:
                fall, accepted = objective - objective_new, True
                u, dcd, objective = new, dcd_new, objective_new
                out, trial = trial, out
                damping = max(damping * 0.33, 1e-9)
                break
            damping *= 4.0
        if not accepted:
            break
        flat = flat + 1 if fall < tolerance else 0
    return u, dcd, spent


@njit(cache=True, nogil=True)
def _track(target, points, normals, lambda_m, temporal, tolerance, iterations, u0):
    frames = len(points)
    us, dcds, spent = np.empty((frames, len(u0))), np.empty(frames), np.empty(frames, np.int64)
    out, trial = _buffers(target, points.shape[1]), _buffers(target, points.shape[1])
    u = np.minimum(np.maximum(u0, target.lower), target.upper)
    for t in range(frames):
        # The first frame has no frame before it to stay near to.
        weight = temporal if t else 0.0
        u, dcds[t], spent[t] = _solve_frame(
            target, points[t], normals[t], lambda_m, weight, tolerance, iterations, u.copy(), u, out, trial
        )
        us[t] = u
    return us, dcds, spent


class NewtonSolver:
    """The default solver. Releases the GIL: run several tracks in threads."""

    def __init__(self, problem: AlignmentProblem, options: SolverOptions) -> None:
        self.options = options
        embodiment, pads = problem.embodiment, problem.representation
        lower, upper = embodiment.independent_limits
        self._target = Target(
            problem.tree.arrays,
            np.ascontiguousarray(pads.body, np.int64),
            np.ascontiguousarray(pads.points_link),
            np.ascontiguousarray(pads.normals_link),
            embodiment.coupled.leader.astype(np.int64),
            embodiment.coupled.scale,
            embodiment.coupled.offset,
            lower,
            upper,
        )

    def track(self, points_base, normals_base, u0, iterations: int | None = None) -> Track:
        """See `Solver.track`."""
        o = self.options
        u, objective, spent = _track(
            self._target,
            np.ascontiguousarray(points_base, float),
            np.ascontiguousarray(normals_base, float),
            o.lambda_m,
            o.temporal_weight,
            o.tolerance,
            o.iterations if iterations is None else iterations,
            np.ascontiguousarray(u0, float),
        )
        return Track(u, objective, spent)

    def derivatives(self, points_base, normals_base, u):
        """DCD, gradient (m,) and majoriser's Hessian (m, m) at one frame, for inspection and tests."""
        points, normals = np.ascontiguousarray(points_base, float), np.ascontiguousarray(normals_base, float)
        out = _buffers(self._target, len(points))
        dcd = _evaluate(self._target, points, normals, self.options.lambda_m, np.ascontiguousarray(u, float), out)
        return dcd, *_derivatives(self._target, points, normals, self.options.lambda_m, out)
