"""Time for a slower target: frames repeated where its joints cannot keep up with the source."""

import numpy as np

from cei_gym.alignment.options import SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.alignment.solvers.newton import NewtonSolver
from cei_gym.alignment.solvers.solver import Solver
from cei_gym.arrays import Array


def retime(
    problem: AlignmentProblem, solver: Solver, options: SolverOptions, motion: Motion, stretch: float
) -> tuple[Array, Track | None]:
    """Which frame of the source each frame of the target shows.

    A hand that is still on its way when the source's closes misses what the source grasped, so the source waits: a frame in
    which some joint moves as fast as it can is shown once more, until none does or the motion is `stretch` times as long.

    Args:
        problem, solver, options: of the target. Whatever the solver, the compiled one says who is late.
        motion: with the `u0` that it is followed from.
        stretch: at least 1, which keeps all frames as they are.

    Returns:
        (T',) indices into the motion's T frames, each at least once, in order; and the motion at those frames followed freely,
        if that was by `solver`.
    """
    count = len(motion.points_base)
    room = int(stretch * count) - count
    if not motion.dt_s or options.velocity_scale <= 0 or not room:
        return np.arange(count), None
    newton = solver if isinstance(solver, NewtonSolver) else NewtonSolver(problem, options)
    frames, track = newton.track_waiting(motion, room)
    return frames, track if newton is solver else None
