"""Following motions: from the frame-0 basin that demonstrations have chosen, or from another where that goes wrong."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cei_gym.alignment.contact.correction import Correction, corrected, dwelling
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.judge.reach import Reach
from cei_gym.alignment.judge.report import AlignmentReport, make_report
from cei_gym.alignment.options import ContactOptions, SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.alignment.retime import retime
from cei_gym.alignment.start.basins import ANOTHER_WAY_M, Basin, are_apart, choose_modes, judge, judge_basins, kinds
from cei_gym.alignment.start.starts import InitialisationOptions, find_basins
from cei_gym.arrays import Array

_FINALISTS = 16  # of eight, the one that costs least on all demonstrations is sometimes none
_SAME_WAY_RAD = 0.5  # between the arm's joints of two basins
_TOLERATED_M = 0.005  # of penetration, and of contact points that miss the source's


@dataclass(frozen=True)
class Followed:
    """A motion at the target's pace, followed.

    Attributes:
        frames: (T',) which of the demonstration's frames are shown, in order.
        motion: at those frames.
        track: what the target does.
    """

    frames: Array
    motion: Motion
    track: Track


@dataclass(frozen=True)
class _FollowedFrom(Followed):
    """And from which basin, and how that went."""

    basin: Basin

    @property
    def wrong(self) -> bool:
        b = self.basin
        return max(b.penetration_m, b.overlap_m, b.contact_miss_m) > _TOLERATED_M or b.torque_share > 1


class Following:
    """Follows motions from basins.

    Args:
        problem: the target.
        solver, init, contact: options.
        stretch, unreachable_mm: see `TransferOptions`.
    """

    def __init__(
        self,
        problem: AlignmentProblem,
        solver: SolverOptions,
        init: InitialisationOptions,
        contact: ContactOptions,
        stretch: float,
        unreachable_mm: float,
    ) -> None:
        self._problem, self._options, self._init = problem, solver, init
        self._stretch, self._unreachable_mm = stretch, unreachable_mm
        self._follower = Follower(problem, solver, contact)
        self._reach = Reach(problem)
        self.basins: list[Basin] = []
        """One a mode, once fitted."""
        self.finalists: list[Basin] = []
        """What `fit` judged on all its motions, best first."""

    def fit(self, motions: Sequence[Motion]) -> None:
        """Choose basins by following candidates through whole motions.

        Raises:
            CEIError: there are fewer distinct motions than `init.modes`.
        """
        first = motions[0]
        starts = find_basins(self._problem, self._options, first.points_base[0], first.normals_base[0], self._init)
        # The first demonstration rules most candidates out; the rest decide among the few that are left, of which each motion that is wanted
        # should have some.
        judged = judge_basins(self._follower, motions[:1], starts, refine=False)
        few = judged[: _FINALISTS * self._init.modes]
        for kind in kinds(judged)[: self._init.modes]:
            few += [basin for basin in kind[:_FINALISTS] if basin not in few]
        self.start_from(judge_basins(self._follower, motions, np.array([b.u for b in few])))

    def start_from(self, finalists: Sequence[Basin]) -> None:
        """Take what was fitted elsewhere.

        Raises:
            CEIError: there are fewer distinct motions than `init.modes`.
        """
        self.finalists = list(finalists)
        self.basins = choose_modes(self.finalists, self._init.modes)

    def others(self, mode: int) -> list[int]:
        """Which finalists are not the mode's own basin, best first; of several modes those of its kind, or a mixture would not stay even."""
        own = self.basins[mode % len(self.basins)]
        rest = [i for i, basin in enumerate(self.finalists) if basin is not own]
        return [i for i in rest if len(self.basins) == 1 or not are_apart(own, self.finalists[i])]

    def follow(self, motion: Motion, mode: int) -> tuple[Followed, AlignmentReport]:
        """Follow a motion from its mode's basin, or where that goes wrong from another that is clearly better: episodes of a dataset share a way,
        and policies learn from what is done alike. One of another kind must be better by far, or reach what its own does not."""
        own = self.basins[mode % len(self.basins)]
        first = self._follow_from(own, motion)
        report = self.report(first.motion, first.track)
        if not (report.unreachable_frames or first.wrong):
            return first, report
        like = [each for each in self.finalists if not are_apart(own, each)]
        best = self._better(first, like, motion, ANOTHER_WAY_M)
        report = self.report(best.motion, best.track)
        if (report.unreachable_frames or best.wrong) and len(self.basins) == 1:
            unlike = [each for each in self.finalists if each not in like]
            other = self._better(best, unlike, motion, 0.0 if report.unreachable_frames else 2 * ANOTHER_WAY_M)
            reached = self.report(other.motion, other.track)
            if not report.unreachable_frames or len(reached.unreachable_frames) < len(report.unreachable_frames):
                best, report = other, reached
        return best, replace(report, another_way=self._is_another_way(own, best.basin))

    def _is_another_way(self, own: Basin, other: Basin) -> bool:
        embodiment = self._problem.embodiment
        arm = embodiment.coupled.independent < embodiment.n_arm
        return bool(np.abs(other.u - own.u)[arm].max(initial=0.0) > _SAME_WAY_RAD)

    def _better(self, own: _FollowedFrom, others: Sequence[Basin], motion: Motion, by_m: float) -> _FollowedFrom:
        """The one of the others that costs least, if that is less than its own by so much, else its own."""
        followed = [self._follow_from(other, motion) for other in others]
        best = min(followed, key=lambda each: each.basin.cost, default=own)
        return best if best.basin.cost < own.basin.cost - by_m else own

    def follow_from(self, finalist: int, motion: Motion) -> tuple[Followed, AlignmentReport]:
        """Follow a motion from one of the finalists, whatever comes of it."""
        basin = self.finalists[finalist]
        followed = self._follow_from(basin, motion)
        another_way = all(self._is_another_way(own, basin) for own in self.basins)
        return followed, replace(self.report(followed.motion, followed.track), another_way=another_way)

    def corrected(
        self, followed: Followed, report: AlignmentReport, correction: Correction
    ) -> tuple[Followed, AlignmentReport]:
        """What is followed with a correction of how it takes hold; how well pads follow counts that as a miss."""
        u = corrected(self._problem, followed.motion, followed.track.u, correction)
        shown = dwelling(followed.motion, len(u), correction)
        motion, track = followed.motion.at(shown), replace(followed.track, u=u).at(shown)
        again = replace(self.report(motion, track), another_way=report.another_way)
        return Followed(followed.frames[shown], motion, track), again

    def report(self, motion: Motion, track: Track) -> AlignmentReport:
        """How well a track follows a motion, and what keeps it where it does not."""
        report = make_report(
            self._problem,
            motion.points_base,
            motion.normals_base,
            track,
            self._options.lambda_m,
            self._unreachable_mm,
            motion.dt_s,
            self._follower.penetration(motion, track.u),
        )
        if motion.surroundings is not None:
            report = replace(report, tool_points=motion.surroundings.tool_points)
        if not report.unreachable_frames:
            return report
        return replace(report, miss=self._reach.explain(motion, track, int(report.pad_distance_mm.argmax())))

    def _follow_from(self, basin: Basin, motion: Motion) -> _FollowedFrom:
        motion = self._follower.started(motion, basin.u)
        frames, free = retime(self._problem, self._follower.solver, self._options, motion, self._stretch)
        motion = motion.at(frames)
        track = self._follower.follow(motion, free)
        return _FollowedFrom(frames, motion, track, judge(self._follower, [motion], basin.u, [track]))
