"""The paper's solver, as the reference: pytorch-kinematics, autograd, Adam, frame by frame (sections IV-B and V-A)."""

from collections.abc import Sequence

import numpy as np
import torch

from cei_gym.alignment.problem import AlignmentProblem, Motion, SolverOptions, Track
from cei_gym.functional.distance import directional_chamfer_distance
from cei_gym.kinematics.torch_chain import TorchChain


class PaperSolver:
    """Equation (2): `w1 DCD + w2 L(q)` with w1 = 1 and L the squared violation of the joint limits."""

    def __init__(self, problem: AlignmentProblem, options: SolverOptions, device: str = "cpu") -> None:
        self.options, self._problem = options, problem
        embodiment, pads = problem.embodiment, problem.representation
        tensor = lambda x: torch.as_tensor(np.asarray(x, float), dtype=torch.float64, device=device)  # noqa: E731
        self._tensor = tensor
        self._chain = TorchChain(embodiment, torch.float64, device)
        bodies, which = np.unique(pads.body, return_inverse=True)
        self._bodies, self._which = [int(b) for b in bodies], torch.as_tensor(which, device=device)
        self._points, self._normals = tensor(pads.points_link), tensor(pads.normals_link)
        self._A, self._b = tensor(embodiment.coupled.A), tensor(embodiment.coupled.offset)
        self._lower, self._upper = (tensor(x) for x in embodiment.independent_limits)

    def track_all(self, motions: Sequence[Motion]) -> list[Track]:
        """See `Solver.track_all`; one after the other."""
        return [self.track(**vars(motion)) for motion in motions]

    def track(
        self, points_base, normals_base, u0, iterations: int | None = None, dt_s=None, surroundings=None
    ) -> Track:
        """See `Solver.track`; `iterations` are Adam steps. The paper knows neither velocity limits nor surroundings."""
        points, normals = self._tensor(points_base), self._tensor(normals_base)
        u, us, objectives, spent = self._tensor(u0), [], [], []
        for t in range(len(points)):
            u, objective, steps = self._frame(points[t], normals[t], u, iterations or self.options.paper.steps)
            us.append(u.cpu().numpy())
            objectives.append(objective)
            spent.append(steps)
        return Track(np.array(us), np.array(objectives), np.array(spent))

    def _frame(self, points, normals, u0, steps: int):
        o = self.options.paper
        u = u0.clone().requires_grad_(True)
        adam = torch.optim.Adam([u], lr=o.learning_rate)
        best, best_u, since, spent = np.inf, u0, 0, 0
        while spent < steps and since < o.patience:
            spent += 1
            adam.zero_grad()
            over = torch.relu(u - self._upper) + torch.relu(self._lower - u)
            loss = self._dcd(points, normals, u) + o.limit_weight * over.square().sum()
            loss.backward()
            value = loss.item()
            if value < best:
                best, best_u, since = value, u.detach().clone(), 0
            else:
                since += 1
            adam.step()
        # The penalty only discourages: limits are respected at every frame.
        best_u = torch.minimum(torch.maximum(best_u, self._lower), self._upper)
        with torch.no_grad():
            return best_u, float(self._dcd(points, normals, best_u)), spent

    def _dcd(self, points, normals, u):
        qpos = (self._A @ u + self._b)[None]
        T = self._chain.forward(qpos, self._bodies)[0][self._which]
        p = torch.einsum("nij,nj->ni", T[:, :3, :3], self._points) + T[:, :3, 3]
        n = torch.einsum("nij,nj->ni", T[:, :3, :3], self._normals)
        return directional_chamfer_distance(points, normals, p, n, self.options.lambda_m)
