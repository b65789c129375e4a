"""What an alignment achieved, frame by frame, so that an episode can be judged without a simulator."""

from dataclasses import dataclass

import numpy as np

from cei_gym.alignment.judge.clearance import Penetration
from cei_gym.alignment.judge.reach import Miss
from cei_gym.alignment.kernels.distance import matched
from cei_gym.alignment.kernels.target import make_target
from cei_gym.alignment.problem import AlignmentProblem, Track
from cei_gym.arrays import Array

_AT_LIMIT = 1e-6
_TOUCHES_MM = 1.0  # less is how meshes are, not how robots are


@dataclass(frozen=True)
class AlignmentReport:
    """Diagnostics of one aligned episode of T frames.

    Attributes:
        pad_distance_mm: (T,) mean distance between matched pairs.
        normal_angle_deg: (T,) mean angle between the normals of matched pairs.
        objective_m: (T,) DCD.
        iterations: (T,) iterations that the solver spent.
        limit_hits: (T,) independent joints that sit at a limit.
        joint_step_rad: (T,) largest change of a joint since the frame before (0 at the first), rad or m.
        arm_at_limit: (T,) whether a joint of the arm sits at a limit: a hand that is open or closed often does.
        speed_share: (T,) largest change of a joint since the frame before, as a share of what its velocity limit allows.
        penetration_mm: (T,) how deep the target is in itself, its stand, the support surface or objects.
        unreachable_mm: pad distance above which a frame counts as out of the target's reach.
        penetrating: link, and what it is in, where that is deepest; empty where nothing touches.
        miss: why it is out of reach, if it is anywhere.
        tool_points: see `Surroundings`.
        another_way: whether it goes another way in the joints than the other episodes.
    """

    pad_distance_mm: Array
    normal_angle_deg: Array
    objective_m: Array
    iterations: Array
    limit_hits: Array
    joint_step_rad: Array
    arm_at_limit: Array
    speed_share: Array
    penetration_mm: Array
    unreachable_mm: float
    penetrating: tuple[str, ...] = ()
    miss: Miss | None = None
    tool_points: float = 0.0
    another_way: bool = False

    @property
    def unreachable_frames(self) -> list[int]:
        """Frames at which the target's pads stay farther away than `unreachable_mm`."""
        return np.flatnonzero(self.pad_distance_mm > self.unreachable_mm).tolist()

    @property
    def penetrates(self) -> str | None:
        """What is in what at which frame, where that is deepest; None where it is hardly anything."""
        frame = int(self.penetration_mm.argmax())
        if not self.penetrating or self.penetration_mm[frame] < _TOUCHES_MM:
            return None
        return f"{' in '.join(self.penetrating)}, frame {frame}"

    def summary(self) -> dict[str, float | int | list[int] | str | None]:
        """The episode in a few numbers, which frames are out of reach and why, and what is in what, for tables and metadata."""
        return {
            "pad_distance_mm_mean": float(self.pad_distance_mm.mean()),
            "pad_distance_mm_max": float(self.pad_distance_mm.max()),
            "normal_angle_deg_mean": float(self.normal_angle_deg.mean()),
            "objective_m_mean": float(self.objective_m.mean()),
            "iterations_mean": float(self.iterations.mean()),
            "limit_hits_max": int(self.limit_hits.max()),
            "joint_step_max_rad": float(self.joint_step_rad.max()),
            "penetration_mm_max": float(self.penetration_mm.max()),
            "penetrates": self.penetrates,
            "unreachable_frames": self.unreachable_frames,
            "unreachable_because": None if self.miss is None else str(self.miss),
            **({"tool_points_mean": self.tool_points} if self.tool_points else {}),
            **({"another_way": True} if self.another_way else {}),
        }


def make_report(
    problem: AlignmentProblem,
    points_base: Array,
    normals_base: Array,
    track: Track,
    lambda_m: float,
    unreachable_mm: float,
    dt_s: float | None = None,
    penetration: Penetration | None = None,
) -> AlignmentReport:
    """Diagnose a track.

    Args:
        problem: of the target.
        points_base, normals_base: (T, N, 3) source representation that it followed, in the target's base frame.
        track: what is judged.
        lambda_m, unreachable_mm: see `SolverOptions` and `AlignmentReport`.
        dt_s: time between frames; without it no joint counts as fast.
        penetration: how deep the target is in something; none if it is not known.
    """
    pad_distance_mm, normal_angle_deg = pad_residuals(problem, points_base, normals_base, track.u, lambda_m)
    lower, upper = problem.embodiment.independent_limits
    at_limit = (track.u <= lower + _AT_LIMIT) | (track.u >= upper - _AT_LIMIT)
    step = np.abs(np.diff(problem.embodiment.coupled.expand(track.u), axis=0, prepend=np.nan)).max(axis=1)
    arm = problem.embodiment.coupled.independent < problem.embodiment.n_arm
    allowed = problem.embodiment.independent_max_velocity * (np.inf if dt_s is None else dt_s)
    moved = np.abs(np.diff(track.u, axis=0, prepend=track.u[:1]))
    return AlignmentReport(
        pad_distance_mm=pad_distance_mm,
        normal_angle_deg=normal_angle_deg,
        objective_m=track.objective,
        iterations=track.iterations,
        limit_hits=at_limit.sum(axis=1),
        joint_step_rad=np.nan_to_num(step),
        arm_at_limit=at_limit[:, arm].sum(axis=1) > 0,
        speed_share=(moved / allowed).max(axis=1),
        penetration_mm=np.zeros(len(track.u)) if penetration is None else 1e3 * penetration.depth_m,
        unreachable_mm=unreachable_mm,
        penetrating=() if penetration is None else penetration.between[int(penetration.depth_m.argmax())],
    )


def pad_residuals(
    problem: AlignmentProblem, points_base: Array, normals_base: Array, u: Array, lambda_m: float
) -> tuple[Array, Array]:
    """How far the target's pads are from the source's, frame by frame.

    Args:
        problem: of the target.
        points_base, normals_base: (T, N, 3) the source's pads in the target's base frame, m and unit.
        u: (T, m) independent joints of the target, rad or m.
        lambda_m: weight of direction by which pairs are matched, metres.

    Returns:
        Mean distance (T,) in mm and mean angle between normals (T,) in degrees of matched pairs.
    """
    distance, angle = matched(
        make_target(problem.representation, problem.tree),
        np.ascontiguousarray(points_base, float),
        np.ascontiguousarray(normals_base, float),
        np.ascontiguousarray(u, float),
        float(lambda_m),
    )
    return 1e3 * distance, np.degrees(angle)
