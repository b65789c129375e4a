"""Functional representations and the distance between them (the paper's section IV-A)."""

from cei_gym.functional.distance import DEFAULT_DIRECTION_WEIGHT_M, directional_chamfer_distance
from cei_gym.functional.representation import VARIANTS, FunctionalRepresentation, sample_representation

__all__ = [
    "DEFAULT_DIRECTION_WEIGHT_M",
    "VARIANTS",
    "FunctionalRepresentation",
    "directional_chamfer_distance",
    "sample_representation",
]
