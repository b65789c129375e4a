"""A solver of one's own: `cei-convert --solver.backend=gradient`. SciPy's L-BFGS-B on the DCD, frame by frame: slow, and twenty lines."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from cei_gym.alignment import AlignmentProblem, Motion, Solver, SolverOptions, Track
from cei_gym.functional import directional_chamfer_distance


class GradientSolver(Solver):
    """Follows a trajectory by quasi-Newton steps with numeric gradients; knows joint limits, no velocities, no obstacles."""

    def __init__(self, problem: AlignmentProblem, options: SolverOptions) -> None:
        self._problem, self._options = problem, options

    def track_all(self, motions: Sequence[Motion]) -> list[Track]:
        """See `Solver.track_all`."""
        return [self._follow(motion) for motion in motions]

    def _follow(self, motion: Motion) -> Track:
        body = self._problem.embodiment
        bounds = list(zip(body.coupled.reduce(body.lower), body.coupled.reduce(body.upper), strict=True))
        most = self._options.iterations if motion.iterations is None else motion.iterations
        u, solved, spent = motion.u0, [], []
        for points, normals in zip(motion.points_base, motion.normals_base, strict=True):

            def dcd(u: np.ndarray, points=points, normals=normals) -> float:
                return float(
                    directional_chamfer_distance(points, normals, *self._problem.place(u), self._options.lambda_m)
                )

            found = minimize(dcd, u, bounds=bounds, options={"maxiter": most})
            u = found.x
            solved.append((u, found.fun))
            spent.append(found.nit)
        return Track(np.array([u for u, _ in solved]), np.array([dcd for _, dcd in solved]), np.array(spent))
