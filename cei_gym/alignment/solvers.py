"""Solvers by name."""

from cei_gym.alignment.newton import NewtonSolver
from cei_gym.alignment.problem import AlignmentProblem, Solver, SolverOptions


def make_solver(problem: AlignmentProblem, options: SolverOptions) -> Solver:
    """The solver that `options.backend` names."""
    if options.backend == "torch":
        from cei_gym.alignment.newton_torch import TorchNewtonSolver  # torch takes seconds to import

        return TorchNewtonSolver(problem, options)
    if options.backend == "paper":
        from cei_gym.alignment.paper import PaperSolver

        return PaperSolver(problem, options)
    return NewtonSolver(problem, options)
