"""Trajectory alignment: the target's joints that make its pads do what the source's did (the paper's section IV-B)."""

from cei_gym.alignment.basins import Basin, choose_modes, judge, judge_basins
from cei_gym.alignment.clearance import Clearance, Penetration
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.grip import Grip, onto_objects, opposing_sides, pad_shapes, source_grip
from cei_gym.alignment.links import link_shapes
from cei_gym.alignment.manual import ManualAlignment
from cei_gym.alignment.pace import pace
from cei_gym.alignment.problem import (
    AlignmentProblem,
    ClearanceOptions,
    ContactOptions,
    Motion,
    PaperOptions,
    SolverOptions,
    Surroundings,
    Track,
)
from cei_gym.alignment.quality import Quality, assess
from cei_gym.alignment.reach import Miss, Reach
from cei_gym.alignment.report import AlignmentReport, make_report, pad_residuals
from cei_gym.alignment.solver import SecondOrderSolver, Solver
from cei_gym.alignment.solvers import make_solver
from cei_gym.alignment.squeeze import squeeze
from cei_gym.alignment.starts import InitialisationOptions, find_basins
from cei_gym.alignment.stream import Stream

__all__ = [
    "AlignmentProblem",
    "AlignmentReport",
    "Basin",
    "Clearance",
    "ClearanceOptions",
    "ContactOptions",
    "Follower",
    "Grip",
    "InitialisationOptions",
    "ManualAlignment",
    "Miss",
    "Motion",
    "PaperOptions",
    "Penetration",
    "Quality",
    "Reach",
    "SecondOrderSolver",
    "Solver",
    "SolverOptions",
    "Stream",
    "Surroundings",
    "Track",
    "assess",
    "choose_modes",
    "find_basins",
    "judge",
    "judge_basins",
    "link_shapes",
    "make_report",
    "make_solver",
    "onto_objects",
    "opposing_sides",
    "pace",
    "pad_residuals",
    "pad_shapes",
    "source_grip",
    "squeeze",
]
