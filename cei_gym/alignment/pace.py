"""Time for a slower target: frames repeated where its joints cannot keep up with the source."""

import numpy as np

from cei_gym.alignment.problem import AlignmentProblem, Motion, Solver, SolverOptions, Track

_ROUNDS = 6
_FULL_SPEED = 0.999


def pace(
    problem: AlignmentProblem, solver: Solver, options: SolverOptions, motion: Motion, stretch: float
) -> tuple[np.ndarray, Track | None]:
    """Which frame of the source each frame of the target shows.

    A hand that is still on its way when the source's closes misses what the source grasped, so the source waits: a frame in
    which some joint moves as fast as it can is shown once more, until none does or the motion is `stretch` times as long.

    Args:
        problem, solver, options: of the target.
        motion: with the `u0` that it is followed from.
        stretch: at least 1, which keeps all frames as they are.

    Returns:
        (T',) indices into the motion's T frames, each at least once, in order; and the motion at those frames followed freely,
        if it has been.
    """
    frames = np.arange(len(motion.points_base))
    if not motion.dt_s or options.velocity_scale <= 0:
        return frames, None
    furthest = problem.embodiment.independent_max_velocity * motion.dt_s * options.velocity_scale
    for _ in range(_ROUNDS):
        room = int(stretch * len(motion.points_base)) - len(frames)
        if room <= 0:
            break
        track = solver.track(motion.points_base[frames], motion.normals_base[frames], motion.u0, dt_s=motion.dt_s)
        late = np.flatnonzero((np.abs(np.diff(track.u, axis=0)) > _FULL_SPEED * furthest).any(axis=1)) + 1
        if not len(late):
            return frames, track
        frames = np.insert(frames, late[:room] + 1, frames[late[:room]])
    return frames, None
