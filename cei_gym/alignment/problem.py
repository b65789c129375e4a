"""The alignment problem of one target embodiment, and what a solver returns for a trajectory (section IV-B)."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.functional.distance import DEFAULT_DIRECTION_WEIGHT_M
from cei_gym.functional.representation import FunctionalRepresentation
from cei_gym.kinematics.tree import KinematicTree


@dataclass(frozen=True)
class PaperOptions:
    """The paper's own optimiser: Adam on autograd gradients (section V-A)."""

    learning_rate: float = 1e-2
    steps: int = 300  # per frame
    patience: int = 10  # steps without improvement
    limit_weight: float = 1.0  # w2


@dataclass(frozen=True)
class SolverOptions:
    """Options of the trajectory alignment.

    Attributes:
        backend: "newton" (second order, compiled) or "paper" (pytorch-kinematics, autograd, Adam).
        lambda_m: weight of direction in the Directional Chamfer Distance, metres (points are in metres).
        temporal_weight: weight w of (w/2)|u_t - u_(t-1)|^2, metres per rad^2 (newton only).
        iterations: most iterations a frame (newton only).
        tolerance: fall of the objective, metres, that counts as none (newton only).
        paper: the reference's own options.
    """

    backend: str = "newton"
    lambda_m: float = DEFAULT_DIRECTION_WEIGHT_M
    temporal_weight: float = 1e-2
    iterations: int = 30
    tolerance: float = 1e-5
    paper: PaperOptions = field(default_factory=PaperOptions)


@dataclass(frozen=True)
class Track:
    """A solved trajectory.

    Attributes:
        u: (T, m) independent joints, rad or m, within limits.
        objective: (T,) DCD of each frame, metres.
        iterations: (T,) iterations (Newton) or steps (Adam) spent.
    """

    u: np.ndarray
    objective: np.ndarray
    iterations: np.ndarray


@dataclass(frozen=True)
class AlignmentProblem:
    """What a solver needs to know of the target.

    Attributes:
        representation: the target's functional representation.
        tree: its kinematics.
    """

    representation: FunctionalRepresentation
    tree: KinematicTree

    @property
    def embodiment(self) -> Embodiment:
        return self.representation.embodiment

    def place(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(..., m) independent joints to pad points and normals (..., N', 3) in the target's base frame."""
        return self.representation.place(self.tree.forward(self.embodiment.coupled.expand(u)))


class Solver(Protocol):
    """Aligns a target to source trajectories; stateless between calls."""

    def track(
        self, points_base: np.ndarray, normals_base: np.ndarray, u0: np.ndarray, iterations: int | None = None
    ) -> Track:
        """Follow a trajectory frame by frame, each started from the last.

        Args:
            points_base, normals_base: (T, N, 3) source representation in the *target's* base frame, m and unit.
            u0: (m,) where frame 0 starts, rad or m.
            iterations: another budget a frame.
        """
        ...
