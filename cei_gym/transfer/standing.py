"""How a target does from a place: quickly, by a few frames followed one from the other, or as a conversion follows.

A place costs what a frame-0 solution costs (`alignment/start/basins`), with what only the place decides: frames that stay out of reach,
arms near a singularity or a limit, a base among what the hand works on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cei_gym.alignment.follow import Follower
from cei_gym.alignment.judge.fidelity import assess
from cei_gym.alignment.judge.report import pad_residuals
from cei_gym.alignment.options import AUTO, SolverOptions
from cei_gym.alignment.problem import AlignmentProblem, Motion, Surroundings
from cei_gym.alignment.solvers.make import make_second_order_solver
from cei_gym.alignment.start.basins import judge
from cei_gym.alignment.start.starts import random_starts
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.transfer.following import Following
from cei_gym.transfer.ground import Ground
from cei_gym.transfer.scenes import Scenes
from cei_gym.transfer.source_side import SourceSide
from cei_gym.transfer.transfer import Transfer

SEARCHED = 16
"""Frames that a place is scored by: of those that are sampled the ones that differ most."""
BASINS = 3
"""Solutions of the first of them from which the others are followed."""
BEYOND_M = 1.0
"""Cost from which a place is not followed at all: the arm is too short, or the base in the way."""

_EACH = 9  # times that each demonstration is followed to judge a place, about
_STARTS, _FIRST_ITERATIONS = 32, 20  # of a place's first frame
_RANDOM = 1024  # configurations that tell how far an arm reaches, and how manipulable it is at its best

_REACH_WEIGHT_M = 0.3  # of cost if all frames are out of reach
_MANIPULABILITY_WEIGHT_M = 0.01  # of cost for a singular arm in all frames, and once more in any
_MANIPULABLE = 0.3  # share of its best that is enough
_LIMIT_WEIGHT_M = 0.01  # the same for a joint of the arm at a limit
_MARGIN = 0.05  # share of its range that is enough
_FIDELITY_WEIGHT_M = 0.02  # of cost for a followed demonstration of no fidelity
_AMONG_WEIGHT = 1.0  # metres of cost a metre that the base stands among what the hand works on
_AWAY_WEIGHT_M = 0.005  # of cost for each: a reach away from where the source stands, and half a turn; of equals the nearest is taken
_SAME_HEIGHT_M = 0.05


@dataclass(frozen=True)
class Standing:
    """How the target does from a place.

    Attributes:
        T_world_base: (4, 4) of its base.
        yaw_rad: how far it is turned against the source's base.
        cost_m: lower is better, metres; the mean objective of followed demonstrations, and penalties.
        fidelity: of the worst demonstration that is followed, from 0 to 1 (`alignment/judge/fidelity`).
        out_of_reach: of the sampled frames, how many pads stay farther from than `unreachable_mm`.
        pad_distance_mm: at the worst of them.
        manipulability: at the worst of them: the least singular value of the arm's Jacobian, as a share of its best.
        limit_margin: how near a joint of the arm comes to a limit, as a share of its range.
        penetration_mm: deepest in itself, the support surface or its stand.
        among_mm: how far its base stands in what the hand works on, or objects.
    """

    T_world_base: Array
    yaw_rad: float
    cost_m: float
    fidelity: float
    out_of_reach: int
    pad_distance_mm: float
    manipulability: float
    limit_margin: float
    penetration_mm: float
    among_mm: float


def followed(frames: int, transfer: Transfer, whole: Sequence[Demonstration]) -> int:
    """About how many frames are solved to judge one place by following."""
    return frames + transfer.init.basins * len(whole[0]) + _EACH * sum(map(len, whole))


class Judging:
    """Judges places: x, y, z (world, m) and yaw against the source's base (rad) of the target's.

    Args:
        transfer: between the embodiments.
        sampled: demonstrations thinned to a few frames each, which places are scored by.
        whole: demonstrations that are followed.
        done: called with the number of frames that are solved, now and then.

    Attributes:
        problem: the target.
        points_world: (N, P, 3) the source's pads at the sampled frames, m.
        reach_m: how far from its base the target's pads come.
        ground: where no base can stand.
    """

    def __init__(
        self,
        transfer: Transfer,
        sampled: Sequence[Demonstration],
        whole: Sequence[Demonstration],
        done: Callable[[int], None],
    ) -> None:
        self._transfer, self._whole, self._done = transfer, whole, done
        self.problem: AlignmentProblem = transfer.problem
        # Whatever solver follows later, hundreds of places take the fastest.
        self._solver: SolverOptions = replace(transfer.solver_options, backend=AUTO, device=AUTO)
        self._follower = Follower(self.problem, self._solver, transfer.contact)
        self._newton = make_second_order_solver(self.problem, self._solver)
        side = SourceSide(transfer.source_representation, transfer.contact, np.eye(4))  # in the world
        placed = [side.place(each.qpos, side.T_target_source(each)) for each in sampled]
        self.points_world: Array = np.concatenate([points for points, _ in placed])
        self._normals_world: Array = np.concatenate([normals for _, normals in placed])
        ends = np.cumsum([len(each) for each in sampled])
        self._frames_of = [slice(int(end) - len(each), int(end)) for end, each in zip(ends, sampled, strict=True)]
        self._few = _most_different(self.points_world, SEARCHED)
        self._support_z_m = min(side.support_z_m(each) for each in sampled)
        scene = sampled[0].scene
        self._T_world_source: Array = scene.T_world_base
        self._starts: Array = random_starts(self.problem, _STARTS, transfer.init.seed)
        self._random: Array = random_starts(self.problem, _RANDOM, 0)
        self.reach_m = float(np.linalg.norm(self.problem.place(self._random)[0].mean(axis=1), axis=1).max())
        self._manipulable: float = float(np.quantile(self._least_singular_value(self._random), 0.95))
        scenes = Scenes(transfer.synthesiser)
        self.ground = Ground(self.problem.embodiment, self.points_world, whole, scenes, scene)

    @property
    def source_place(self) -> tuple[Array, float]:
        """Where the source stands."""
        return self._T_world_source[:3, 3], 0.0

    @property
    def heights_m(self) -> list[float]:
        """Where a base may stand: as high as the source's, or on the support surface."""
        z_m = float(self._T_world_source[2, 3])
        return [z_m] if abs(z_m - self._support_z_m) < _SAME_HEIGHT_M else [z_m, self._support_z_m]

    def T_world_base(self, position_m: Array, yaw_rad: float) -> Array:
        """(4, 4): the source's base, turned about the vertical and moved."""
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        T = np.eye(4)
        T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ self._T_world_source[:3, :3]
        T[:3, 3] = position_m
        return T

    def _of_place(self, position_m: Array, yaw_rad: float) -> float:
        """What a place costs whatever the arm does there, m."""
        away = np.linalg.norm(position_m - self._T_world_source[:3, 3]) / self.reach_m + abs(yaw_rad) / np.pi
        return _AMONG_WEIGHT * self.ground.among_m(position_m) + _AWAY_WEIGHT_M * float(away)

    def beyond_m(self, position_m: Array) -> float:
        """How far the source's pads are out of the arm's reach from there, m, in the mean."""
        away_m = np.linalg.norm(self.points_world.mean(axis=1) - position_m, axis=1)
        return float(np.maximum(away_m - self.reach_m, 0.0).mean())

    def score(self, position_m: Array, yaw_rad: float) -> float:
        """The cost of a place by a few frames, m, followed one from the other."""
        among_m, beyond_m = self.ground.among_m(position_m), self.beyond_m(position_m)
        self._done(len(self._few) * BASINS)
        if beyond_m > 0.1 * self.reach_m or among_m > self.ground.footprint_m:
            return BEYOND_M + beyond_m + among_m
        points, normals = self._seen_from(self.T_world_base(position_m, yaw_rad), self._few)
        u, objective = self._newton.solve_starts(points[0], normals[0], self._starts, _FIRST_ITERATIONS)
        first = u[np.argsort(objective, kind="stable")[:BASINS]]
        surroundings = Surroundings(self._support_z_m - float(position_m[2]))
        motions = [Motion(points, normals, u0, surroundings=surroundings) for u0 in first]
        tracks = self._follower.follow_all(motions, refine=False)
        return self._of_place(position_m, yaw_rad) + min(
            judge(self._follower, [motion], motion.u0, [track]).cost + self._of_frames(motion, track.u)[0]
            for motion, track in zip(motions, tracks, strict=True)
        )

    def follow(self, position_m: Array, yaw_rad: float) -> Standing:
        """Follow whole demonstrations from a place, then all sampled frames from where that starts."""
        T = self.T_world_base(position_m, yaw_rad)
        transfer, problem = self._transfer, self.problem
        following = Following(
            problem,
            self._solver,
            replace(transfer.init, modes=1, mode=None),
            transfer.contact,
            transfer.options.stretch,
            transfer.options.unreachable_mm,
        )
        side = SourceSide(transfer.source_representation, transfer.contact, T)
        home = problem.embodiment.coupled.reduce(problem.embodiment.home)
        whole = [side.motion(each, home) for each in self._whole]
        following.fit(whole)
        basin = following.basins[0]
        fidelity = min(assess(following.follow(each, 0)[1]).score for each in whole)
        points, normals = self._seen_from(T, np.arange(len(self.points_world)))
        surroundings = Surroundings(self._support_z_m - float(position_m[2]))
        # Each demonstration from where it starts, as it will be followed.
        motions = [
            Motion(points[frames], normals[frames], basin.u, surroundings=surroundings) for frames in self._frames_of
        ]
        tracks = self._follower.follow_all(motions, refine=False)
        motion = Motion(points, normals, basin.u, surroundings=surroundings)
        u = np.concatenate([track.u for track in tracks])
        cost_m, away_mm, manipulability, margin = self._of_frames(motion, u)
        self._done(followed(len(points), transfer, self._whole))
        return Standing(
            T,
            yaw_rad,
            basin.cost + cost_m + self._of_place(position_m, yaw_rad) + _FIDELITY_WEIGHT_M * (1.0 - fidelity),
            fidelity,
            int((away_mm > transfer.options.unreachable_mm).sum()),
            float(away_mm.max()),
            float(manipulability.min()),
            float(margin.min()),
            1e3 * max(basin.penetration_m, float(self._follower.penetration(motion, u).depth_m.max())),
            1e3 * self.ground.among_m(position_m),
        )

    def _of_frames(self, motion: Motion, u: Array) -> tuple[float, Array, Array, Array]:
        """What frames cost beside their basin's cost, m; how far pads are away (mm), manipulability and margins to limits, (N,) each."""
        away_mm, _ = pad_residuals(self.problem, motion.points_base, motion.normals_base, u, self._solver.lambda_m)
        manipulability = self._least_singular_value(u) / self._manipulable
        margin = self._margin(u)
        unreached = away_mm > self._transfer.options.unreachable_mm
        awkward_m = _MANIPULABILITY_WEIGHT_M * np.maximum(0.0, 1.0 - manipulability / _MANIPULABLE)
        awkward_m += _LIMIT_WEIGHT_M * np.maximum(0.0, 1.0 - margin / _MARGIN)
        cost_m = _REACH_WEIGHT_M * unreached.mean() + awkward_m.mean() + awkward_m.max()
        return float(cost_m), away_mm, manipulability, margin

    def _margin(self, u: Array) -> Array:
        """(N,) how near a joint of the arm is to a limit, as a share of its range; 0.5 in the middle."""
        lower, upper = self.problem.embodiment.independent_limits
        arm = self.problem.embodiment.coupled.independent < self.problem.embodiment.n_arm
        share = np.minimum(u - lower, upper - u)[:, arm] / (upper - lower)[arm]
        return np.maximum(share, 0.0).min(axis=1, initial=0.5)

    def _least_singular_value(self, u: Array) -> Array:
        """(N,) of the Jacobian from the arm's independent joints to the hand, lengths in units of the arm's reach."""
        embodiment = self.problem.embodiment
        coupled = embodiment.coupled
        of_joints = self.problem.tree.jacobian(coupled.expand(u), embodiment.end_effector_root, np.zeros(3))
        of_arm = (of_joints @ coupled.A)[..., coupled.independent < embodiment.n_arm]
        if not of_arm.shape[-1]:
            return np.ones(len(u))
        of_arm[:, :3] /= self.reach_m
        return np.linalg.svd(of_arm, compute_uv=False)[:, -1]

    def _seen_from(self, T_world_base: Array, frames: Array) -> tuple[Array, Array]:
        R, t = T_world_base[:3, :3], T_world_base[:3, 3]
        return (self.points_world[frames] - t) @ R, self._normals_world[frames] @ R


def _most_different(points_world: Array, most: int) -> Array:
    """Indices of at most so many of N frames, in order: the first, and in turn those whose pads are farthest from all taken before."""
    flat = points_world.reshape(len(points_world), -1)
    taken: list[int] = [0]
    away = np.linalg.norm(flat - flat[0], axis=1)
    while len(taken) < min(most, len(flat)):
        taken.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(flat - flat[taken[-1]], axis=1))
    return np.array(sorted(taken))
