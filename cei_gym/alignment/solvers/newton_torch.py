"""The default solver's method in torch: many trajectories at once, on any device.

Trajectories are independent, so each is at a frame of its own: in every round each tries one damped step, and one whose
frame is solved begins its next. Nothing waits for the slowest of a frame.
"""

from collections import defaultdict
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from cei_gym.alignment.kernels.frame import DAMPING_TRIES
from cei_gym.alignment.kernels.step import DAMPING, EASED, LARGEST_STEP, LEAST_DAMPING, STIFFENED
from cei_gym.alignment.kernels.target import make_target
from cei_gym.alignment.links import collision_constraint
from cei_gym.alignment.options import SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.alignment.solvers.device import choose_device, widest_real
from cei_gym.alignment.solvers.solver import SecondOrderSolver
from cei_gym.alignment.solvers.torch_model import TorchModel
from cei_gym.alignment.solvers.torch_records import BatchPose, Sources
from cei_gym.arrays import Array


class _State(NamedTuple):
    """Where B trajectories are.

    Attributes:
        frame, first, end: (B,) the frame being solved, among those of all motions, and the trajectory's own range.
        budget: (B,) most iterations a frame.
        reach: (B, m) farthest that joints move between frames, rad or m.
        last, before: (B, m) solutions of the last two frames.
        lower, upper, anchor: (B, m) the frame's box and what it stays near to; weight: (B,) how much.
        u, objective, dcd, gradient, hessian: the best so far of the frame, and derivatives there.
        candidate: (B, m) what is tried next; starting: (B,) whether that is the frame's start.
        damping, tries, flat, spent: (B,) of the Levenberg-Marquardt schedule.
    """

    frame: Tensor
    first: Tensor
    end: Tensor
    budget: Tensor
    reach: Tensor
    last: Tensor
    before: Tensor
    lower: Tensor
    upper: Tensor
    anchor: Tensor
    weight: Tensor
    u: Tensor
    objective: Tensor
    dcd: Tensor
    gradient: Tensor
    hessian: Tensor
    candidate: Tensor
    starting: Tensor
    damping: Tensor
    tries: Tensor
    flat: Tensor
    spent: Tensor


class TorchNewtonSolver(SecondOrderSolver):
    """Levenberg-Marquardt on a majoriser of the DCD, batched. Double precision, except on "mps", which has none.

    Args:
        problem: the target.
        options: see there; `device` says where it computes.

    Raises:
        CEIError: no such device, here or at all.
    """

    def __init__(self, problem: AlignmentProblem, options: SolverOptions) -> None:
        self.options, self._problem = options, problem
        self._device = choose_device(options.device)
        self._free = self._model(guarded=False)

    def _model(self, guarded: bool) -> TorchModel:
        target = make_target(self._problem.representation, self._problem.tree, all_joints=guarded)
        collision = collision_constraint(self._problem, self.options.clearance) if guarded else None
        dtype = widest_real(self._device)
        return TorchModel(target, collision, float(self.options.lambda_m), self._device, dtype)

    @cached_property
    def _guarded(self) -> TorchModel:
        """The target with all its joints (idle fingers move out of the way, too), and its links."""
        return self._model(guarded=True)

    def track_all(self, motions: Sequence[Motion]) -> list[Track]:
        """See `Solver.track_all`: one batch for each number of points, with surroundings and without."""
        batches = defaultdict(list)
        for i, motion in enumerate(motions):
            batches[motion.points_base.shape[1], motion.surroundings is not None].append(i)
        tracks: dict[int, Track] = {}
        for (_, guarded), members in batches.items():
            model = self._guarded if guarded else self._free
            some = [motions[i] for i in members]
            tracks.update(zip(members, self._follow(model, some, self._departure(model, some)), strict=True))
        return [tracks[i] for i in range(len(motions))]

    def solve_starts(self, points_base, normals_base, starts, iterations: int) -> tuple[Array, Array]:
        """Solve one frame, (N, 3) each, from many starts (S, m), as one batch.

        Returns:
            (S, m) independent joints, rad or m, and (S,) DCD, metres.
        """
        tracks = self.track_all([Motion(points_base[None], normals_base[None], u0, iterations) for u0 in starts])
        return np.concatenate([t.u for t in tracks]), np.concatenate([t.objective for t in tracks])

    def advance(self, points_base, normals_base, last, before, dt_s: float | None = None) -> Array:
        """One more frame, (N, 3) each, after the last two solutions (m,); the new one."""
        motions = [Motion(points_base[None], normals_base[None], last, dt_s=dt_s)]
        state = self._departure(self._free, motions)
        state = state._replace(first=state.first - 2, last=self._free.tensor(before)[None])
        return self._follow(self._free, motions, state)[0].u[0]

    def derivatives(self, points_base, normals_base, u) -> tuple[float, Array, Array]:
        """DCD, gradient (m,) and majoriser's Hessian (m, m) at one frame, for inspection and tests."""
        model = self._free
        sources = model.sources([Motion(points_base[None], normals_base[None], u)])
        dcd, _, pose = model.evaluate(
            model.tensor(u)[None], sources, torch.zeros(1, dtype=torch.long, device=self._device)
        )
        gradient, hessian = model.derivatives(pose)
        return float(dcd[0]), gradient[0].cpu().numpy(), hessian[0].cpu().numpy()

    @torch.inference_mode()
    def _follow(self, model: TorchModel, motions: Sequence[Motion], state: _State) -> list[Track]:
        sources = model.sources(motions)
        frames = len(sources.origin)
        u, dcd = model.lower.new_empty(frames, len(model.lower)), model.lower.new_empty(frames)
        spent = torch.empty(frames, dtype=torch.int64, device=self._device)
        state = self._begin(model, state)
        while len(state.frame):
            state = self._step(self._try(model, sources, state))
            solved = state.starting.nonzero()[:, 0]
            if len(solved):
                at = state.frame[solved]
                u[at], dcd[at], spent[at] = state.u[solved], state.dcd[solved], state.spent[solved]
                state = self._begin(model, state)
        found = u.cpu().double().numpy(), dcd.cpu().double().numpy(), spent.cpu().numpy()
        ends = np.cumsum([len(m.points_base) for m in motions])[:-1]
        return [Track(*parts) for parts in zip(*(np.split(x, ends) for x in found), strict=True)]

    def _departure(self, model: TorchModel, motions: Sequence[Motion]) -> _State:
        """All trajectories just before their first frames."""
        whole = lambda x: torch.as_tensor(np.asarray(x, np.int64), device=self._device)  # noqa: E731
        length = np.array([len(m.points_base) for m in motions])
        first = np.cumsum(length) - length
        dt = np.array([(m.dt_s or 0.0) * self.options.velocity_scale for m in motions])
        reach = model.tensor(np.where(dt > 0, dt, np.inf))[:, None] * model.fastest
        u = model.tensor(np.array([m.u0 for m in motions])).clamp(model.lower, model.upper)
        budget = [self.options.iterations if m.iterations is None else m.iterations for m in motions]
        none, zero = whole(np.zeros(len(u))), torch.zeros_like(u[:, 0])
        return _State(
            whole(first - 1), whole(first), whole(first + length), whole(budget), reach, u, u, u, u, u, zero, u,
            objective=zero, dcd=zero, gradient=torch.zeros_like(u), hessian=torch.zeros_like(u[:, None] * u[..., None]),
            candidate=u, starting=none == 0, damping=zero, tries=none, flat=none, spent=none,
        )  # fmt: skip

    def _begin(self, model: TorchModel, s: _State) -> _State:
        """Bring trajectories whose frame is solved to their next one, and drop those that have none."""
        o, new = self.options, s.starting[:, None]
        before = torch.where(new, torch.where((s.frame <= s.first)[:, None], s.u, s.last), s.before)
        last, frame = torch.where(new, s.u, s.last), s.frame + s.starting
        # The first frame has no frame before it to stay near to.
        opening = frame == s.first
        reach = torch.where(opening[:, None], torch.inf, s.reach)
        weight = o.temporal_weight + o.smoothness_weight
        lean = o.smoothness_weight / weight if weight > 0 else 0.0
        s = s._replace(
            frame=frame,
            last=last,
            before=before,
            lower=torch.maximum(model.lower, last - reach),
            upper=torch.minimum(model.upper, last + reach),
            # Both quadratics, one about the last solution and one about its continuation, are one about this.
            anchor=last + lean * (last - before),
            weight=weight * (~opening).to(last.dtype),
            candidate=torch.where(new, s.u, s.candidate),
        )
        left = frame < s.end
        return s if left.all() else _State(*(x[left] for x in s))

    def _try(self, model: TorchModel, sources: Sources, s: _State) -> _State:
        """Move to candidates where the objective, matches renewed, is lower there."""
        u, objective, dcd, pose = _evaluate(model, sources, s)
        # Hardly any candidate is refused: derivatives of all are cheaper than to pick.
        accept = s.starting | (objective < s.objective)
        gradient, hessian = model.derivatives(pose)
        gradient = gradient + s.weight[:, None] * (u - s.anchor)
        hessian.diagonal(dim1=1, dim2=2).add_(s.weight[:, None])
        flat = torch.where(s.objective - objective < self.options.tolerance, s.flat + 1, 0)
        damping = torch.where(accept, (EASED * s.damping).clamp(min=LEAST_DAMPING), STIFFENED * s.damping)
        return s._replace(
            u=torch.where(accept[:, None], u, s.u),
            objective=torch.where(accept, objective, s.objective),
            dcd=torch.where(accept, dcd, s.dcd),
            gradient=torch.where(accept[:, None], gradient, s.gradient),
            hessian=torch.where(accept[:, None, None], hessian, s.hessian),
            damping=torch.where(s.starting, DAMPING, damping),
            tries=torch.where(accept, 0, s.tries + 1),
            flat=torch.where(s.starting, 0, torch.where(accept, flat, s.flat)),
            spent=torch.where(s.starting, 0, s.spent),
        )

    def _step(self, s: _State) -> _State:
        """Choose what is tried next, or find that the frame is solved."""
        fresh = s.tries == 0
        over = fresh & ((s.flat >= 2) | (s.spent >= s.budget))
        candidate, fall = _damped_step(s)
        level = (fall >= 0) & (fall < self.options.tolerance)
        return s._replace(
            candidate=candidate,
            starting=over | level | (s.tries >= DAMPING_TRIES),
            spent=s.spent + (fresh & ~over),
        )


def _evaluate(model: TorchModel, sources: Sources, s: _State) -> tuple[Tensor, Tensor, Tensor, BatchPose]:
    """Candidates (B, m), or for a frame's start the continuation of its motion where that is better.

    Returns:
        (B, m) which it was, (B,) objective and (B,) DCD there, m, and the pose.
    """
    every, start = torch.arange(len(s.u), device=s.u.device), s.starting.nonzero()[:, 0]
    onward = (2 * s.last[start] - s.before[start]).clamp(s.lower[start], s.upper[start])
    which, u = torch.cat([every, start]), torch.cat([s.candidate, onward])
    dcd, penalty, pose = model.evaluate(u, sources, s.frame[which])
    objective = dcd + penalty + 0.5 * s.weight[which] * (u - s.anchor[which]).square().sum(1)
    best = every.clone()
    better = objective[len(every) :] < objective[start]
    best[start] = torch.where(better, len(every) + every[: len(start)], start)
    return u[best], objective[best], dcd[best], pose.take(best)


def _damped_step(s: _State) -> tuple[Tensor, Tensor]:
    """A damped Newton step inside the box (B, m), and (B,) how far the quadratic model falls; see `kernels.step`."""
    outward = ((s.u <= s.lower) & (s.gradient > 0)) | ((s.u >= s.upper) & (s.gradient < 0))
    fixed = outward | (s.hessian.diagonal(dim1=1, dim2=2) <= 0)
    delta, down, up = torch.zeros_like(s.u), s.lower - s.u, s.upper - s.u
    while True:  # each round fixes at least one joint of those that are left
        delta, failed = _solve_free(s, delta, fixed)
        outside = ~fixed & ~((down <= delta) & (delta <= up))
        if not outside.any():
            break
        delta = torch.where(outside, torch.where(delta < 0, down, up), delta)
        fixed = fixed | outside
    fall = -(delta * (s.gradient + 0.5 * (s.hessian @ delta[..., None])[..., 0])).sum(1)
    # What cannot be computed is tried, which gains nothing, and then tried again with more damping.
    return (s.u + delta).clamp(s.lower, s.upper), torch.where(failed, torch.inf, fall)


def _solve_free(s: _State, delta: Tensor, fixed: Tensor) -> tuple[Tensor, Tensor]:
    """Steps (B, m) of the free joints, those of the others held, and (B,) whether there was no solution."""
    free = (~fixed).to(delta.dtype)
    system = s.hessian * free[:, None] * free[:, :, None]
    system.diagonal(dim1=1, dim2=2).add_(torch.where(fixed, 1.0, s.damping[:, None]))
    held = torch.where(fixed, delta, 0.0)
    force = free * (s.gradient + (s.hessian @ held[..., None])[..., 0])
    factor, failed = torch.linalg.cholesky_ex(system)
    # In two steps: Metal has no `cholesky_solve`.
    half = torch.linalg.solve_triangular(factor, -force[..., None], upper=False)
    step = torch.linalg.solve_triangular(factor.mT, half, upper=True)[..., 0]
    shrink = (LARGEST_STEP / step.abs().amax(dim=1, keepdim=True)).clamp(max=1)
    failed = failed > 0
    return torch.where(fixed | failed[:, None], held, shrink * step), failed
