"""The alignment for live control: one source frame in, one target configuration out."""

from cei_gym.alignment.contact.live import LiveGrasp
from cei_gym.alignment.grip import Grip
from cei_gym.alignment.options import SolverOptions
from cei_gym.alignment.problem import AlignmentProblem
from cei_gym.alignment.solvers.make import make_second_order_solver
from cei_gym.alignment.start.starts import InitialisationOptions, find_basins
from cei_gym.arrays import Array


class Stream:
    """Follows frame after frame as they come. Compiled and warm once constructed.

    Args:
        problem: the target.
        options: as for whole trajectories; `clearance` is left out.
        init: how the first frame starts, if `u0` does not say it.
        u0: (m,) where the first frame starts, rad or m.
        dt_s: time between frames; with it, joints keep their velocity limits.
        grasp: carries contact over; None leaves it.
    """

    def __init__(
        self,
        problem: AlignmentProblem,
        options: SolverOptions,
        init: InitialisationOptions | None = None,
        u0: Array | None = None,
        dt_s: float | None = None,
        grasp: LiveGrasp | None = None,
    ) -> None:
        self._problem, self._options, self._init = problem, options, init or InitialisationOptions()
        self._u0, self._dt_s, self._grasp = u0, dt_s, grasp
        self._solver = make_second_order_solver(problem, options)
        self._last: tuple[Array, Array] | None = None
        home = problem.embodiment.coupled.reduce(problem.embodiment.home)
        points, normals = problem.place(home)
        self._solver.advance(points, normals, home, home, dt_s)  # compiles

    def __call__(self, points_base: Array, normals_base: Array, grip: Grip | None = None) -> Array:
        """One frame.

        Args:
            points_base, normals_base: (N, 3) source representation in the target's base frame, m and unit.
            grip: what the source does, in this frame alone; contact is carried over with it.

        Returns:
            (m,) independent joints, rad or m.
        """
        if self._last is None:
            start = self._u0
            if start is None:
                start = find_basins(self._problem, self._options, points_base, normals_base, self._init)[0]
            u = self._solver.track(points_base[None], normals_base[None], start).u[0]
            self._last = u, u
        else:
            last, before = self._last
            u = self._solver.advance(points_base, normals_base, last, before, self._dt_s)
            self._last = u, last
        if self._grasp is None or grip is None:
            return u.copy()
        return self._grasp(grip, self._last[1], u)

    def resume_from(self, u: Array) -> None:
        """Forget the past, but for where the joints are: (m,) rad or m. The next frame is followed from there."""
        self._last = u, u
        if self._grasp is not None:
            self._grasp.reset(u)

    def reset(self) -> None:
        """Forget the past: the next frame is a first one."""
        self._last = None
        if self._grasp is not None:
            self._grasp.reset()
