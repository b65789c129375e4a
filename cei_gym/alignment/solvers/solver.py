"""What a solver of the alignment is (the paper's section IV-B2), and what the stages around it need of one."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from cei_gym.alignment.options import SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Surroundings, Track
from cei_gym.arrays import Array


class Solver(ABC):
    """Aligns a target to source trajectories; stateless between calls.

    A package offers one of its own by an entry point of the group `cei_gym.solvers`; `SolverOptions.backend` is then its name.

    Args:
        problem: of the target.
        options: as they were given.
    """

    @abstractmethod
    def __init__(self, problem: AlignmentProblem, options: SolverOptions) -> None: ...

    @abstractmethod
    def track_all(self, motions: Sequence[Motion]) -> list[Track]:
        """Follow many trajectories, in parallel."""

    def track(
        self,
        points_base: Array,
        normals_base: Array,
        u0: Array,
        iterations: int | None = None,
        dt_s: float | None = None,
        surroundings: Surroundings | None = None,
    ) -> Track:
        """Follow a trajectory frame by frame, each started from the last.

        Args:
            points_base, normals_base: (T, N, 3) source representation in the *target's* base frame, m and unit.
            u0: (m,) where frame 0 starts, rad or m.
            iterations: another budget a frame.
            dt_s: time between frames; with it, joints keep their velocity limits.
            surroundings: with it, links keep clear of them (`ClearanceOptions`).
        """
        return self.track_all([Motion(points_base, normals_base, u0, iterations, dt_s, surroundings)])[0]


class SecondOrderSolver(Solver):
    """A solver that also searches one frame from many starts, and takes frames as they come."""

    @abstractmethod
    def solve_starts(
        self, points_base: Array, normals_base: Array, starts: Array, iterations: int
    ) -> tuple[Array, Array]:
        """Solve one frame, (N, 3) each, from (S, m) starts.

        Returns:
            (S, m) independent joints and (S,) DCD, metres.
        """

    @abstractmethod
    def advance(
        self,
        points_base: Array,
        normals_base: Array,
        last: Array,
        before: Array,
        dt_s: float | None = None,
    ) -> Array:
        """One more frame, (N, 3) each, after the last two solutions (m,); the new one."""
