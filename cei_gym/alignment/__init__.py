"""Trajectory alignment: the target's joints that make its pads do what the source's did (the paper's section IV-B)."""

from cei_gym.alignment.basins import Basin, InitialisationOptions, find_basins, judge_basins
from cei_gym.alignment.problem import AlignmentProblem, PaperOptions, Solver, SolverOptions, Track
from cei_gym.alignment.report import AlignmentReport
from cei_gym.alignment.solvers import BACKENDS, make_solver

__all__ = [
    "BACKENDS",
    "AlignmentProblem",
    "AlignmentReport",
    "Basin",
    "InitialisationOptions",
    "PaperOptions",
    "Solver",
    "SolverOptions",
    "Track",
    "find_basins",
    "judge_basins",
    "make_solver",
]
