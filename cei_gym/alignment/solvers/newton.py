"""The default solver: second order, compiled, one frame after the other (see `kernels`).

Our own because no library minimises a Chamfer distance over a kinematic tree to second order.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property

import numpy as np

from cei_gym.alignment.kernels.collision import at_frame
from cei_gym.alignment.kernels.distance import evaluate
from cei_gym.alignment.kernels.frame import Settings, empty_memory, solve_frame
from cei_gym.alignment.kernels.quadratic import add_distance, project
from cei_gym.alignment.kernels.target import load_source, make_target
from cei_gym.alignment.links import collision_constraint, no_collision_constraint, pack_obstacles
from cei_gym.alignment.options import SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.alignment.solvers.solver import SecondOrderSolver
from cei_gym.arrays import Array
from cei_gym.compiled import njit

_FULL_SPEED = 0.999


@njit(cache=True, nogil=True)
def _track(target, points, normals, settings, collision, obstacles, dt_s, u0, room):
    """Joints, DCDs and iterations of each frame, and which of the source's it shows; `room` is for those shown again."""
    most, m = len(points) + room, len(u0)
    us, dcds, spent, shown = np.empty((most, m)), np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64)
    memory = empty_memory(target, points.shape[1])
    u = np.minimum(np.maximum(u0, target.lower), target.upper)
    last, before = u.copy(), u.copy()
    source, frames = 0, 0
    while source < len(points):
        around = at_frame(obstacles, source)
        # The first frame has no frame before it to stay near to.
        dcds[frames], spent[frames] = solve_frame(
            target,
            points[source],
            normals[source],
            settings,
            collision,
            around,
            dt_s if frames else -1.0,
            last,
            before,
            memory,
            u,
        )
        late = False
        if room > 0 and frames:
            for k in range(m):
                late = late or abs(u[k] - last[k]) > _FULL_SPEED * target.fastest[k] * dt_s
        before[:] = last if frames else u
        last[:] = u
        us[frames], shown[frames] = u, source
        frames += 1
        if late:
            room -= 1
        else:
            source += 1
    return us[:frames], dcds[:frames], spent[:frames], shown[:frames]


@njit(cache=True, nogil=True)
def _solve_starts(target, points, normals, settings, collision, starts):
    us, dcds = np.empty_like(starts), np.empty(len(starts))
    memory = empty_memory(target, len(points))
    nothing = np.empty((0, 3))
    for i in range(len(starts)):
        u = np.minimum(np.maximum(starts[i], target.lower), target.upper)
        dcds[i], _ = solve_frame(target, points, normals, settings, collision, nothing, -1.0, u, u, memory, u)
        us[i] = u
    return us, dcds


@njit(cache=True, nogil=True)
def _advance(target, points, normals, settings, collision, dt_s, last, before):
    u = np.minimum(np.maximum(last, target.lower), target.upper)
    memory = empty_memory(target, len(points))
    solve_frame(target, points, normals, settings, collision, np.empty((0, 3)), dt_s, last, before, memory, u)
    return u


class NewtonSolver(SecondOrderSolver):
    """Levenberg-Marquardt on a majoriser of the DCD. Releases the GIL: trajectories run in threads, one a core."""

    def __init__(self, problem: AlignmentProblem, options: SolverOptions) -> None:
        self.options, self._problem = options, problem
        self._target = make_target(problem.representation, problem.tree)
        self._free = self._target, no_collision_constraint()
        self._settings = Settings(
            float(options.lambda_m),
            float(options.temporal_weight),
            float(options.smoothness_weight),
            float(options.tolerance),
            options.iterations,
        )

    @cached_property
    def _guarded(self):
        """The target with all its joints (idle fingers move out of the way, too), and its links."""
        whole = make_target(self._problem.representation, self._problem.tree, all_joints=True)
        return whole, collision_constraint(self._problem, self.options.clearance)

    def track_waiting(self, motion: Motion, room: int) -> tuple[Array, Track]:
        """Follow a motion freely, showing again each frame in which a joint moves as fast as it can.

        Args:
            motion: with its `dt_s`; its surroundings are left out.
            room: how many frames may be shown again, in all.

        Returns:
            (T',) indices into the motion's T frames, each at least once, in order, and the track through them.
        """
        return self._track(replace(motion, surroundings=None), room)

    def _track(self, motion: Motion, room: int = 0) -> tuple[Array, Track]:
        iterations, surroundings = motion.iterations, motion.surroundings
        target, collision = self._free
        if surroundings is not None:
            target, collision = self._guarded
            collision = collision._replace(height_m=float(surroundings.support_z_base_m))
        obstacles = pack_obstacles(surroundings, len(motion.points_base))
        settings = self._settings if iterations is None else self._settings._replace(iterations=iterations)
        u, objective, spent, shown = _track(
            target,
            np.ascontiguousarray(motion.points_base, float),
            np.ascontiguousarray(motion.normals_base, float),
            settings,
            collision,
            obstacles,
            (motion.dt_s or 0.0) * self.options.velocity_scale,
            np.ascontiguousarray(motion.u0, float),
            room,
        )
        return shown, Track(u, objective, spent)

    def track_all(self, motions: Sequence[Motion]) -> list[Track]:
        """See `Solver.track_all`."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return [track for _, track in pool.map(self._track, motions)]

    def advance(self, points_base, normals_base, last, before, dt_s: float | None = None) -> Array:
        """One more frame, (N, 3) each, after the last two solutions (m,); the new one."""
        target, collision = self._free
        return _advance(
            target,
            np.ascontiguousarray(points_base, float),
            np.ascontiguousarray(normals_base, float),
            self._settings,
            collision,
            (dt_s or 0.0) * self.options.velocity_scale,
            last,
            before,
        )

    def solve_starts(self, points_base, normals_base, starts, iterations: int) -> tuple[Array, Array]:
        """Solve one frame, (N, 3) each, from many starts.

        Returns:
            (S, m) independent joints and (S,) DCD, metres.
        """
        points, normals = np.ascontiguousarray(points_base, float), np.ascontiguousarray(normals_base, float)
        settings = self._settings._replace(iterations=iterations)

        def solve(some: Array):
            return _solve_starts(self._target, points, normals, settings, self._free[1], some)

        cores = os.cpu_count() or 1
        with ThreadPoolExecutor(cores) as pool:
            found = list(pool.map(solve, np.array_split(np.ascontiguousarray(starts, float), 4 * cores)))
        return np.concatenate([u for u, _ in found]), np.concatenate([dcd for _, dcd in found])

    def derivatives(self, points_base, normals_base, u):
        """DCD, gradient (m,) and majoriser's Hessian (m, m) at one frame, for inspection and tests."""
        target, lambda_m = self._target, self._settings.lambda_m
        memory = empty_memory(target, len(points_base))
        load_source(np.ascontiguousarray(points_base, float), np.ascontiguousarray(normals_base, float), memory.source)
        dcd = evaluate(target, memory.source, lambda_m, np.ascontiguousarray(u, float), memory.pose)
        add_distance(target, memory.source, lambda_m, memory.pose, memory.quadratic)
        project(target, memory.source.origin, memory.pose, memory.quadratic)
        return dcd, memory.quadratic.gradient, memory.quadratic.hessian
