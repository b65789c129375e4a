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

    def track(self, points_base, normals_base, u0, iterations=None, dt_s=None, surroundings=None) -> Track:
        """See `Solver.track`."""
        body = self._problem.embodiment
        bounds = list(zip(body.coupled.reduce(body.lower), body.coupled.reduce(body.upper), strict=True))
        u, solved, spent = u0, [], []
        for points, normals in zip(points_base, normals_base, strict=True):

            def dcd(u: np.ndarray, points=points, normals=normals) -> float:
                return float(
                    directional_chamfer_distance(points, normals, *self._problem.place(u), self._options.lambda_m)
                )

            found = minimize(dcd, u, bounds=bounds, options={"maxiter": iterations or self._options.iterations})
            u = found.x
            solved.append((u, found.fun))
            spent.append(found.nit)
        return Track(np.array([u for u, _ in solved]), np.array([dcd for _, dcd in solved]), np.array(spent))

    def track_all(self, motions: Sequence[Motion]) -> list[Track]:
        """See `Solver.track_all`."""
        return [self.track(m.points_base, m.normals_base, m.u0, m.iterations, m.dt_s, m.surroundings) for m in motions]
