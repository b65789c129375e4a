"""Solvers by name."""

from cei_gym.alignment.newton import NewtonSolver
from cei_gym.alignment.problem import AlignmentProblem, Solver, SolverOptions
from cei_gym.errors import unknown

BACKENDS = ("auto", "numba", "torch", "paper")


def make_solver(problem: AlignmentProblem, options: SolverOptions) -> Solver:
    """The solver that `options.backend` names.

    Raises:
        CEIError: no such backend (the message lists the valid ones).
    """
    if options.backend in ("auto", "numba"):
        return NewtonSolver(problem, options)
    if options.backend == "torch":
        from cei_gym.alignment.newton_torch import TorchNewtonSolver  # torch takes seconds to import

        return TorchNewtonSolver(problem, options)
    if options.backend == "paper":
        from cei_gym.alignment.paper import PaperSolver

        return PaperSolver(problem, options)
    raise unknown("solver backend", options.backend, BACKENDS)
