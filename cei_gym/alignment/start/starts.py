"""Where frame 0 starts: distinct solutions of the first frame, by multi-start or by the paper's elite means."""

from dataclasses import dataclass

import numpy as np

from cei_gym.alignment.options import SolverOptions
from cei_gym.alignment.problem import AlignmentProblem
from cei_gym.alignment.solvers.make import make_second_order_solver
from cei_gym.alignment.solvers.solver import SecondOrderSolver
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, unknown

METHODS = ("multistart", "eis", "given")
_SAME_RAD = 0.15
_REFINE_ITERATIONS = 200
_ELITE_SHARE = 0.1
_MOST = 1_000_000


@dataclass(frozen=True)
class InitialisationOptions:
    """How frame 0 starts.

    Attributes:
        method: "multistart" (many random starts, each solved), "eis" (the paper's elite-based initialisation, section
            VII-B: the mean of the best tenth of random configurations, once a draw) or "given" (`qpos`).
        modes: distinct motions wanted, in which the hand does something else; episodes take turns.
        mode: the one of them that all episodes take, from 0, the best; None for turns.
        seed: of every random choice.
        starts: random configurations: solved each by "multistart", ranked by each draw of "eis".
        iterations: most iterations a start of "multistart".
        draws: means taken by "eis"; more find more modes.
        basins: distinct solutions a mode that are then judged on whole demonstrations.
        qpos: joint positions that "given" starts from, in the target's order, rad or m.
    """

    method: str = "multistart"
    modes: int = 1
    mode: int | None = None
    seed: int = 0
    starts: int = 512
    iterations: int = 30
    draws: int = 64
    basins: int = 32
    qpos: list[float] | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise unknown("init.method", self.method, METHODS)
        for name in ("modes", "starts", "iterations", "draws", "basins"):
            if getattr(self, name) < 1:
                raise CEIError(f"init.{name}={getattr(self, name)} must be at least 1.")
            if getattr(self, name) > _MOST:
                raise CEIError(f"init.{name}={getattr(self, name)} must be at most {_MOST}.")
        if self.mode is not None and self.mode < 0:
            raise CEIError(f"init.mode={self.mode} must be at least 0.")
        if self.mode is not None and not self.mode < self.modes > 1:
            raise CEIError(
                f"init.mode={self.mode} is one of init.modes={self.modes}, counted from 0, which should be at least 2."
            )
        if self.seed < 0:
            raise CEIError(f"init.seed={self.seed} must be at least 0.")
        if (self.method == "given") != (self.qpos is not None):
            raise CEIError("init.method=given and init.qpos go together: give both or neither.")
        if self.method == "given" and self.modes > 1:
            raise CEIError(f"init.method=given starts one motion; init.modes={self.modes} asks for more.")


def find_basins(
    problem: AlignmentProblem,
    solver: SolverOptions,
    points_base: Array,
    normals_base: Array,
    options: InitialisationOptions,
) -> Array:
    """Distinct frame-0 solutions, best first.

    Args:
        points_base, normals_base: (N, 3) the source's representation at frame 0, target's base frame.

    Returns:
        (K, m) independent joints, rad or m, within limits, 1 <= K <= options.basins * options.modes.

    Raises:
        CEIError: `options.qpos` does not fit the target.
    """
    newton = make_second_order_solver(problem, solver)
    if options.method == "given":
        starts = _given(problem, options)[None]
    elif options.method == "eis":
        starts = elite_starts(problem, newton, points_base, normals_base, options)
    else:
        starts = random_starts(problem, options.starts, options.seed)
    most = options.basins * options.modes
    found, objective = newton.solve_starts(points_base, normals_base, starts, options.iterations)
    few = _distinct(unwrap(problem, found), objective, 2 * most)
    found, objective = newton.solve_starts(points_base, normals_base, found[few], _REFINE_ITERATIONS)
    found = unwrap(problem, found)
    return found[_distinct(found, objective, most)]


def active_joints(problem: AlignmentProblem) -> Array:
    """(m,) which independent joints move a pad at all; the others keep their home position."""
    coupled = problem.embodiment.coupled
    active = np.zeros(len(coupled.independent), bool)
    active[coupled.leader[problem.tree.moving(problem.representation.body)]] = True
    return active


def random_starts(problem: AlignmentProblem, n: int, seed: int | list[int]) -> Array:
    """(n, m) independent joints, uniform within limits and within pi of home, so that no joint starts wrapped."""
    lower, upper = problem.embodiment.independent_limits
    home = problem.embodiment.coupled.reduce(problem.embodiment.home)
    lower, upper = np.maximum(lower, home - np.pi), np.minimum(upper, home + np.pi)
    u = np.random.default_rng(seed).uniform(lower, upper, (n, len(home)))
    return np.where(active_joints(problem), u, home)


def elite_starts(
    problem: AlignmentProblem,
    newton: SecondOrderSolver,
    points_base: Array,
    normals_base: Array,
    options: InitialisationOptions,
) -> Array:
    """(draws, m) elite means: of `starts` random configurations, the mean of the tenth with the least DCD (EIS).

    A mean over a symmetric space lies between its modes, and small draws fall to one side or the other: their diversity
    is the paper's.
    """
    means: list[Array] = []
    for draw in range(options.draws):
        u = random_starts(problem, options.starts, [options.seed, draw])
        _, objective = newton.solve_starts(points_base, normals_base, u, 0)
        elite = np.argsort(objective, kind="stable")[: max(1, round(_ELITE_SHARE * len(u)))]
        means.append(u[elite].mean(axis=0))
    return np.array(means)


def unwrap(problem: AlignmentProblem, u: Array) -> Array:
    """(K, m) solutions with every hinge brought by whole turns to within pi of home where its limits allow that.

    A turn must leave all that follows the joint where it was, so only joints that nothing else follows are turned.
    """
    embodiment = problem.embodiment
    lower, upper = embodiment.independent_limits
    home = embodiment.coupled.reduce(embodiment.home)
    alone = np.bincount(embodiment.coupled.leader, minlength=len(home)) == 1
    hinge = np.array([embodiment.joint_units[q] == "rad" for q in embodiment.coupled.independent])
    turned = u - 2 * np.pi * np.round((u - home) / (2 * np.pi))
    return np.where(alone & hinge & (turned >= lower) & (turned <= upper), turned, u)


def _given(problem: AlignmentProblem, options: InitialisationOptions) -> Array:
    embodiment, qpos = problem.embodiment, np.array(options.qpos, float)
    names = ", ".join(embodiment.joint_names)
    if len(qpos) != len(embodiment.joint_names):
        raise CEIError(
            f"init.qpos has {len(qpos)} values; {embodiment.name} has {len(embodiment.joint_names)} joints: {names}."
        )
    for q in np.flatnonzero(~((qpos >= embodiment.lower - 1e-6) & (qpos <= embodiment.upper + 1e-6))):
        raise CEIError(
            f"init.qpos puts {embodiment.joint_names[q]} at {qpos[q]:.4g}, outside "
            f"[{embodiment.lower[q]:.4g}, {embodiment.upper[q]:.4g}] {embodiment.joint_units[q]}."
        )
    return embodiment.coupled.reduce(qpos)


def _distinct(u: Array, objective: Array, most: int) -> list[int]:
    """Indices of solutions that differ from every better one, best first."""
    kept: list[int] = []
    for i in np.argsort(objective, kind="stable"):
        if len(kept) == most:
            break
        if not kept or np.abs(u[kept] - u[i]).max(axis=1).min() > _SAME_RAD:
            kept.append(int(i))
    return kept
