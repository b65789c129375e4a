"""Alignment problems of the catalogue's robots."""

from functools import cache

import numpy as np

from cei_gym.alignment import AlignmentProblem
from cei_gym.embodiment import load_embodiment
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree


@cache
def problem_of(name: str, points: int = 32, seed: int = 0) -> AlignmentProblem:
    """A robot as a target, with so many points on its pads."""
    embodiment = load_embodiment(name)
    return AlignmentProblem(sample_representation(embodiment, points, seed), KinematicTree(embodiment))


def home(problem: AlignmentProblem) -> np.ndarray:
    """(m,) independent joints where it waits."""
    return problem.embodiment.coupled.reduce(problem.embodiment.home)
