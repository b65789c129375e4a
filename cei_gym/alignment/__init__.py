"""Trajectory alignment: the target's joints that make its pads do what the source's did (the paper's section IV-B).

What a solver of one's own, or a caller of `Transfer`, needs; the rooms (`solvers`, `contact`, `start`, `judge`, `kernels`) have the rest.
"""

from cei_gym.alignment.judge.report import AlignmentReport
from cei_gym.alignment.options import ClearanceOptions, ContactOptions, PaperOptions, SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Surroundings, Track
from cei_gym.alignment.solvers.make import make_solver
from cei_gym.alignment.solvers.solver import SecondOrderSolver, Solver
from cei_gym.alignment.start.starts import InitialisationOptions
from cei_gym.alignment.stream import Stream

__all__ = [
    "AlignmentProblem",
    "AlignmentReport",
    "ClearanceOptions",
    "ContactOptions",
    "InitialisationOptions",
    "Motion",
    "PaperOptions",
    "SecondOrderSolver",
    "Solver",
    "SolverOptions",
    "Stream",
    "Surroundings",
    "Track",
    "make_solver",
]
