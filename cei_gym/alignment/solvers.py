"""Solvers by name."""

from cei_gym.alignment.newton import NewtonSolver
from cei_gym.alignment.problem import AlignmentProblem, SecondOrderSolver, Solver, SolverOptions


def make_solver(problem: AlignmentProblem, options: SolverOptions) -> Solver:
    """The solver that `options.backend` names."""
    if options.backend == "paper":
        from cei_gym.alignment.paper import PaperSolver  # torch takes seconds to import

        return PaperSolver(problem, options)
    return make_second_order_solver(problem, options)


def make_second_order_solver(problem: AlignmentProblem, options: SolverOptions) -> SecondOrderSolver:
    """The same, or the default one where `options.backend` is of first order."""
    if options.backend == "torch":
        from cei_gym.alignment.newton_torch import TorchNewtonSolver

        return TorchNewtonSolver(problem, options)
    return NewtonSolver(problem, options)
