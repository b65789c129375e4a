"""Solvers by name."""

from pkgutil import resolve_name

from cei_gym import extras, plugins
from cei_gym.alignment.options import AUTO, SolverOptions
from cei_gym.alignment.problem import AlignmentProblem
from cei_gym.alignment.registry import DEFAULT_SOLVER, GROUP, OWN
from cei_gym.alignment.solvers.solver import SecondOrderSolver, Solver


def make_solver(problem: AlignmentProblem, options: SolverOptions) -> Solver:
    """The solver that `options.backend` names.

    Raises:
        CEIError: a package offers it, but it cannot be imported, or is no `Solver`; or it needs an extra that is missing.
    """
    return _class(options.backend)(problem, options)


def make_second_order_solver(problem: AlignmentProblem, options: SolverOptions) -> SecondOrderSolver:
    """The same, or the default one where that is not of second order."""
    found = _class(options.backend)
    return found(problem, options) if issubclass(found, SecondOrderSolver) else _own(DEFAULT_SOLVER)(problem, options)


def _class(backend: str) -> type[Solver]:
    name = DEFAULT_SOLVER if backend == AUTO else backend
    return _own(name) if name in OWN else plugins.load(GROUP, name, Solver, "solver")


def _own(name: str):
    with extras.needed_by(f"the solver {name!r}"):
        return resolve_name(OWN[name])
