"""A source embodiment acted by a target: what the source is told, the target does; what the target does, the source feels."""

import numpy as np

from cei_gym.alignment import AlignmentProblem
from cei_gym.alignment.contact.squeeze import squeeze
from cei_gym.alignment.solvers.make import make_second_order_solver
from cei_gym.alignment.start.starts import find_basins
from cei_gym.arrays import Array
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.transfer import Transfer


class Impersonation:
    """Turns joint targets of a source into those of a target, and joint positions of the target into the source's.

    The source's pads at its targets are followed frame by frame (the paper's section IV-B); a hand told to close further than
    it is squeezes, as in `Transfer`. Back, the source is where it was told to be, but for what the target's pads lack: of two
    alignments of the source, with the pads as they should be and as they are, only the difference counts, so that what one
    body cannot imitate of the other is no error.

    Args:
        transfer: from the source to the target, fitted to demonstrations of the source.
        T_target_source: (4, 4) pose of the source's base in the target's.
        dt_s: time between actions; with it, joints keep their velocity limits, and what is held is known.

    Attributes:
        qpos: (n,) the source's joints, rad or m.
        holds: whether something is held: since the hand was told to close and came to rest, until it is told to open.

    Raises:
        CEIError: the transfer has not been fitted.
    """

    def __init__(self, transfer: Transfer, T_target_source: Array, dt_s: float | None = None) -> None:
        self._transfer = transfer
        self.source, self.target = transfer.source, transfer.target
        if not transfer.basins:
            raise CEIError(
                f"how {self.target.name} starts where {self.source.name} does is not known; "
                "call the transfer's `fit` with a few demonstrations first."
            )
        self._source, self._stream = transfer.live(dt_s, T_target_source)
        problem = AlignmentProblem(transfer.source_representation, KinematicTree(self.source))
        self._back = problem, make_second_order_solver(problem, transfer.solver_options)
        self._T_back = np.linalg.inv(T_target_source)
        self._hand = self.target.coupled.independent >= self.target.n_arm
        self.reset(self.source.home)
        self.observe(self.act(self.source.home))  # compiles

    def reset(self, qpos: Array) -> Array:
        """Start with the source at `qpos` (n,); joint positions (n',) of the target there, rad or m."""
        self._stream.reset()
        self._source.reset()
        self.holds = False
        self.qpos = np.asarray(qpos, float)
        start = self._follow(self.qpos, 0.0)
        self._measured = self._expected.copy()
        return start

    def begin_at(self, qpos: Array) -> None:
        """Start with the target at `qpos` (n',), and the source where its pads come nearest to the target's."""
        self._measured = self._expected = self.target.coupled.reduce(np.asarray(qpos, float))
        self._stream.resume_from(self._measured)
        self._source.reset()
        self.holds = False
        problem, _ = self._back
        points, normals = self._pads_in_source(self._measured)
        u = find_basins(problem, self._transfer.solver_options, points, normals, self._transfer.init)[0]
        self.qpos = self.source.coupled.expand(u)

    def act(self, action: Array) -> Array:
        """Joint targets (n,) of the source to those of the target (n',), rad or m."""
        told = np.clip(np.asarray(action, float), self.source.lower, self.source.upper)
        hand = slice(self.source.n_arm, None)
        # The arm goes where it is told. A hand that is to close stays where it is, and presses; one that is to open opens.
        still = told.copy()
        still[hand] = self.qpos[hand]
        closing_m = self._source.closing_m(still, told)
        self.qpos = still if closing_m > 0 else told
        qpos = self._follow(self.qpos, closing_m)
        if closing_m <= 0:
            return qpos
        followed = self._expected.copy()
        self._expected[self._hand] = self._measured[self._hand]  # it stays as it is, unless it can be pressed further
        depth_m = np.array([min(closing_m, self._transfer.contact.squeeze_m)])
        u = squeeze(self._transfer.problem, followed[None], depth_m)[0]
        return self.target.coupled.expand(u)

    def observe(self, qpos: Array) -> Array:
        """Joint positions (n',) of the target, after it has acted, to those of the source (n,), rad or m."""
        self._measured = self.target.coupled.reduce(np.asarray(qpos, float))
        # Fingers are asked apart: an arm that lags behind must not look like a hand that opens.
        fingers = np.where(self._hand, self._measured, self._expected)
        is_, gripping, should_be = (
            self.source.coupled.expand(self._imitate(u)) for u in (self._measured, fingers, self._expected)
        )
        moved = is_ - should_be
        moved[self.source.n_arm :] = (gripping - should_be)[self.source.n_arm :]
        self.qpos = np.clip(self.qpos + moved, self.source.lower, self.source.upper)
        return self.qpos.copy()

    def _follow(self, qpos: Array, closing_m: float) -> Array:
        grip = self._source.grip(qpos, closing_m)
        closes = closing_m > self._transfer.contact.held_m
        self.holds = closes and (self.holds or (grip is not None and bool(grip.held.any())))
        self._expected = self._stream(*self._source.place(qpos), grip)
        return self.target.coupled.expand(self._expected)

    def _imitate(self, u: Array) -> Array:
        """(m,) the source's independent joints where the target's pads are those at `u` (m',)."""
        _, solver = self._back
        start = self.source.coupled.reduce(self.qpos)
        return solver.advance(*self._pads_in_source(u), start, start)

    def _pads_in_source(self, u: Array) -> tuple[Array, Array]:
        """The target's points and normals (N', 3) at `u` (m',), in the source's base frame."""
        points, normals = self._transfer.problem.place(u)
        R, t = self._T_back[:3, :3], self._T_back[:3, 3]
        return points @ R.T + t, normals @ R.T
