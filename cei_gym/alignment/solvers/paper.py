"""The paper's solver, as the reference: pytorch-kinematics, autograd, Adam, frame by frame (sections IV-B and V-A)."""

from collections.abc import Sequence

import numpy as np
import torch

from cei_gym.alignment.options import SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.alignment.solvers.device import choose_device, widest_real
from cei_gym.alignment.solvers.solver import Solver
from cei_gym.kinematics.torch_chain import TorchChain


class PaperSolver(Solver):
    """Equation (2): `w1 DCD + w2 L(q)` with w1 = 1 and L the squared violation of the joint limits.

    Trajectories are solved together, as the paper's "highly parallelized computations" are. It knows neither velocity limits
    nor surroundings.
    """

    def __init__(self, problem: AlignmentProblem, options: SolverOptions) -> None:
        """See `Solver`; `options.device` says where it computes.

        Raises:
            CEIError: there is no such device here.
        """
        self.options, self._problem = options, problem
        self.device = device = choose_device(options.device)
        embodiment, pads, dtype = problem.embodiment, problem.representation, widest_real(device)
        tensor = lambda x: torch.as_tensor(np.asarray(x, float)).to(device=device, dtype=dtype)  # noqa: E731
        self._tensor = tensor
        self._chain = TorchChain(embodiment, dtype, str(device))
        bodies, which = np.unique(pads.body, return_inverse=True)
        self._bodies, self._which = [int(b) for b in bodies], torch.as_tensor(which, device=device)
        self._points, self._normals = tensor(pads.points_link), tensor(pads.normals_link)
        self._A, self._b = tensor(embodiment.coupled.A), tensor(embodiment.coupled.offset)
        self._lower, self._upper = (tensor(x) for x in embodiment.independent_limits)

    def track_all(self, motions: Sequence[Motion]) -> list[Track]:
        """See `Solver.track_all`; `iterations` are Adam steps, and the first motion's hold for all."""
        if not motions:
            return []
        lengths = [len(m.points_base) for m in motions]
        # A trajectory that has ended waits in its last frame for the longest one.
        frame = lambda values, t: self._tensor(np.stack([v[min(t, len(v) - 1)] for v in values]))  # noqa: E731
        points, normals = [m.points_base for m in motions], [m.normals_base for m in motions]
        u, found = self._tensor(np.stack([m.u0 for m in motions])), []
        for t in range(max(lengths)):
            steps = motions[0].iterations or self.options.paper.steps
            u, objective, spent = self._frame(frame(points, t), frame(normals, t), u, steps)
            found.append((u.cpu().numpy(), objective, spent))
        us, objectives, spents = (np.stack(x, axis=1) for x in zip(*found, strict=True))
        return [Track(us[i, :T], objectives[i, :T], spents[i, :T]) for i, T in enumerate(lengths)]

    def _frame(self, points, normals, u0, steps: int):
        """(B, N, 3) points and normals from (B, m) u0; each trajectory stops by itself."""
        o = self.options.paper
        u = u0.clone().requires_grad_(True)
        adam = torch.optim.Adam([u], lr=o.learning_rate)
        best, best_u = torch.full_like(u0[:, 0], torch.inf), u0.clone()
        since, spent = torch.zeros((2, len(u0)), dtype=torch.int64, device=self.device)
        running = torch.ones(len(u0), dtype=torch.bool, device=self.device)
        for _ in range(steps):
            adam.zero_grad()
            at = running.nonzero()[:, 0]  # those that have stopped cost nothing more
            over = torch.relu(u[at] - self._upper) + torch.relu(self._lower - u[at])
            loss = self._dcd(points[at], normals[at], u[at]) + o.limit_weight * over.square().sum(-1)
            loss.sum().backward()
            with torch.no_grad():
                spent[at] += 1
                better = loss < best[at]
                best[at] = torch.where(better, loss, best[at])
                best_u[at] = torch.where(better[:, None], u[at], best_u[at])
                since[at] = torch.where(better, 0, since[at] + 1)
                running = since < o.patience
                if not running.any():
                    break
            adam.step()
        # The penalty only discourages: limits are respected at every frame.
        best_u = torch.minimum(torch.maximum(best_u, self._lower), self._upper)
        with torch.no_grad():
            return best_u, self._dcd(points, normals, best_u).cpu().numpy(), spent.cpu().numpy()

    def _dcd(self, points, normals, u):
        T = self._chain.forward(u @ self._A.T + self._b, self._bodies)[:, self._which]
        p = torch.einsum("bnij,nj->bni", T[..., :3, :3], self._points) + T[..., :3, 3]
        n = torch.einsum("bnij,nj->bni", T[..., :3, :3], self._normals)
        # `directional_chamfer_distance` in the form that is fastest in torch: a third of the time of broadcasting
        cost = torch.cdist(points, p, compute_mode="use_mm_for_euclid_dist") - self.options.lambda_m * normals @ n.mT
        return cost.amin(-1).mean(-1) + cost.amin(-2).mean(-1)
