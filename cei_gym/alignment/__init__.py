"""Trajectory alignment: the target's joints that make its pads do what the source's did (the paper's section IV-B)."""

from cei_gym.alignment.contact.grip import Grip, onto_objects, opposing_sides, pad_shapes, source_grip
from cei_gym.alignment.contact.squeeze import squeeze
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.judge.clearance import Clearance, Penetration
from cei_gym.alignment.judge.quality import Quality, assess
from cei_gym.alignment.judge.reach import Miss, Reach
from cei_gym.alignment.judge.report import AlignmentReport, make_report, pad_residuals
from cei_gym.alignment.links import link_shapes
from cei_gym.alignment.manual import ManualAlignment
from cei_gym.alignment.options import ClearanceOptions, ContactOptions, PaperOptions, SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Surroundings, Track
from cei_gym.alignment.retime import pace
from cei_gym.alignment.solvers.make import make_solver
from cei_gym.alignment.solvers.solver import SecondOrderSolver, Solver
from cei_gym.alignment.start.basins import Basin, choose_modes, judge, judge_basins
from cei_gym.alignment.start.starts import InitialisationOptions, find_basins
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
