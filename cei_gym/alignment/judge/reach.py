"""Why a target's pads stay away from the source's: what "out of reach" is in an episode, and what would help."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cei_gym.alignment.contact.pads import opposing_sides
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.arrays import Array

_SAMPLES = 4096
_NEAR_LIMIT = 1e-3  # rad or m
_FULL_SPEED = 0.999
_SHARE = 0.5  # of the distance that a cause must explain to be named
_POSE = 6  # joints that any pose takes


@dataclass(frozen=True)
class Miss:
    """What keeps a target from the source's pads, at the frame where it is worst.

    Attributes:
        frame: that frame.
        pad: link of the target's pad that is farthest away.
        distance_m: mean distance of that pad's points to the source's they should be at, m.
        cause: in a clause, with numbers.
        remedy: in a sentence: what would help.
    """

    frame: int
    pad: str
    distance_m: float
    cause: str
    remedy: str

    def __str__(self) -> str:
        return f"at frame {self.frame} {self.pad} is {1e3 * self.distance_m:.0f} mm away: {self.cause}. {self.remedy}"


class Reach:
    """What a target can reach, to say why it does not.

    Args:
        problem: of the target.
    """

    def __init__(self, problem: AlignmentProblem) -> None:
        self._problem = problem
        coupled, embodiment = problem.embodiment.coupled, problem.embodiment
        self._names = [embodiment.joint_names[q] for q in coupled.independent]
        self._units = [embodiment.joint_units[q] for q in coupled.independent]
        self._arm = coupled.independent < embodiment.n_arm

    def explain(self, motion: Motion, track: Track, frame: int) -> Miss:
        """Why the target is not where it should be at a frame.

        Args:
            motion: what it should follow; with its `grip`, hands that open too little are told from arms that are too short.
            track: how it does.
            frame: the one to explain.
        """
        points, _ = self._problem.place(track.u[frame])
        wanted = motion.points_base[frame]
        nearest = wanted[np.linalg.norm(points[:, None] - wanted, axis=2).argmin(axis=1)]
        distance_m = np.linalg.norm(nearest - points, axis=1)
        bodies, of_body = np.unique(self._problem.representation.body, return_inverse=True)
        far_m = [distance_m[of_body == i].mean() for i in range(len(bodies))]
        worst = int(np.argmax(far_m))
        pad = self._problem.embodiment.link_names[bodies[worst]]
        offset_m = float(np.linalg.norm(wanted.mean(axis=0) - points.mean(axis=0)))
        cause, remedy = self._cause(motion, track, frame, float(far_m[worst]), offset_m)
        return Miss(frame, pad, float(far_m[worst]), cause, remedy)

    def _cause(self, motion: Motion, track: Track, frame: int, distance_m: float, offset_m: float) -> tuple[str, str]:
        """Cause and remedy, given how far the worst pad, and the middle of all pads, is from where it should be."""
        source_m = _width_m(motion, frame)
        if source_m is not None and self._widest_m is not None and source_m - self._widest_m > _SHARE * distance_m:
            return (
                f"the source's pads are {1e3 * source_m:.0f} mm apart there, and the target's open to "
                f"{1e3 * self._widest_m:.0f} mm",
                "If the source's gripper does not open so far, its columns or their unit are wrong (--joint_map, cei-inspect).",
            )
        away_m = float(np.linalg.norm(motion.points_base[frame].mean(axis=0)))
        if away_m > self._reach_m and offset_m > _SHARE * distance_m:
            return (
                f"the source's pads are {away_m:.2f} m from the target's base, whose own reach {self._reach_m:.2f} m",
                "Stand the target elsewhere with --target_pose.",
            )
        if (joint := self._fast(motion, track, frame)) is not None:
            speed = self._problem.embodiment.independent_max_velocity[joint]
            return (
                f"{self._names[joint]} already moves as fast as it can ({speed:.3g} {self._units[joint]}/s)",
                "Give it more time with --transfer.stretch, or see whether the source really moves so fast (cei-inspect).",
            )
        lower, upper = self._problem.embodiment.independent_limits
        u = track.u[frame]
        at_limit = np.flatnonzero(self._arm & ((u - lower < _NEAR_LIMIT) | (upper - u < _NEAR_LIMIT)))
        if len(at_limit):
            named = ", ".join(f"{self._names[q]} ({u[q]:.3g} {self._units[q]})" for q in at_limit)
            return (
                f"at a limit: {named}",
                "Stand the target elsewhere with --target_pose, or have it start otherwise with --init.seed.",
            )
        if 0 < self._arm.sum() < _POSE:
            return (
                f"an arm of {self._arm.sum()} joints does not reach every pose",
                "Stand the target elsewhere with --target_pose.",
            )
        if motion.surroundings is not None and offset_m > _SHARE * distance_m:
            return (
                "no joint is at a limit; links keep clear of the table, of objects or of the robot's stand",
                "Is the table where it should be (--calibration)? --solver.clearance.weight=0 shows the way without.",
            )
        return (
            "no joint is at a limit, and the hand as a whole is where it should be",
            "Are its pads those that the source's stand for? cei-pads shows them.",
        )

    def _fast(self, motion: Motion, track: Track, frame: int) -> int | None:
        """A joint that moves as fast as it can at a frame."""
        if not motion.dt_s or not frame:
            return None
        allowed = self._problem.embodiment.independent_max_velocity * motion.dt_s
        fast = np.flatnonzero(np.abs(track.u[frame] - track.u[frame - 1]) > _FULL_SPEED * allowed)
        return int(fast[0]) if len(fast) else None

    @cached_property
    def _widest_m(self) -> float | None:
        """How far apart the hand's two sides come, m; None where no two close on each other."""
        sides = opposing_sides(self._problem.representation, self._problem.tree)
        if sides is None:
            return None
        apart = self._random[:, sides == 0].mean(axis=1) - self._random[:, sides == 1].mean(axis=1)
        return float(np.linalg.norm(apart, axis=1).max())

    @cached_property
    def _reach_m(self) -> float:
        """How far from the base the middle of the pads comes, m."""
        return float(np.linalg.norm(self._random.mean(axis=1), axis=1).max())

    @cached_property
    def _random(self) -> Array:
        """(S, N, 3) pads at random configurations, each joint as often near an end as between: extremes are what is looked for."""
        lower, upper = self._problem.embodiment.independent_limits
        share = np.random.default_rng(0).beta(0.5, 0.5, (_SAMPLES, len(lower)))
        return self._problem.place(lower + share * (upper - lower))[0]


def _width_m(motion: Motion, frame: int) -> float | None:
    """How far apart the source's two sides are at a frame, m; None where no two close on each other."""
    if motion.grip is None:
        return None
    across = motion.grip.contacts[frame, 1] - motion.grip.contacts[frame, 0]
    return abs(float(across @ motion.grip.axis[frame]))
