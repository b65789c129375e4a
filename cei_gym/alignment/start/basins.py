"""Which frame-0 solution to follow: the one whose whole trajectories cost least.

Solutions within a millimetre of each other in objective can put a hand into its own forearm or under the table, which shows
only later in the episode, so candidates are judged by following whole demonstrations.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.alignment.follow import Follower
from cei_gym.alignment.problem import AlignmentProblem, Motion, Track
from cei_gym.arrays import Array
from cei_gym.errors import CEIError

_PENETRATION_WEIGHT = 1.0  # metres of objective a metre of penetration
_OVERLAP_WEIGHT = 0.5  # metres of objective a metre that a link is in an object
_MISS_WEIGHT = 2.0  # metres of objective a metre between contact points and the source's
_SIDE_WEIGHT = 0.01  # metres of objective for a hand that comes from the opposite side of the source's, where nobody knows what is in the way
_TORQUE_WEIGHT = 0.3  # metres of objective for static torque a full limit above the allowed share: such an arm sinks
_TORQUE_SHARE = 0.8
_LAG_WEIGHT = 0.05  # metres of objective if some joint moves as fast as it can in all frames
_MARGIN_WEIGHT = 0.01  # metres of objective if some arm joint is near a limit in all frames
_NEAR_LIMIT_RAD = 0.05
_APART_RAD, _APART_M = np.pi / 3, 0.1  # the hands of two modes are turned, or away, by this much
_WORSE_M = 0.015  # how much more than the best a further mode may cost
ANOTHER_WAY_M = 0.05
"""What it costs a demonstration to go another way than the others: policies learn from what is done alike."""
_CHECKED_FRAMES = 20  # of each demonstration, for penetration and torque
_WORST = ("penetration_m", "overlap_m", "torque_share", "joint_step_rad")
_MEANS = ("cost", "objective", "side", "contact_miss_m", "lag_share", "limit_share")  # over demonstrations


@dataclass(frozen=True, eq=False)
class Basin:
    """A frame-0 solution and what following it through demonstrations costs.

    Attributes:
        u: (m,) independent joints at frame 0, rad or m.
        costs: (M,) of each demonstration, metres; its mean objective plus penalties (lower is better).
        cost: their mean, where each counts at most what it costs to go another way.
        objective: metres; mean DCD over the demonstrations.
        penetration_m: deepest contact of the target with itself, the support surface or its stand.
        overlap_m: deepest a link is in an object that the cloud shows, but for pads in what is gripped.
        side: from 0, the hand is on the side of its pads that the source's is, to 1, it is on the opposite one; in the mean.
        contact_miss_m: how far contact points are from the source's while it holds something, in the mean.
        torque_share: largest static joint torque as a share of its limit.
        lag_share: share of frames in which a joint moves as fast as it can.
        limit_share: share of frames in which an arm joint is near one of its limits.
        joint_step_rad: largest joint step between frames.
        hands_base: (2, 4, 4) where the end-effector's first link is as the first demonstration starts and as it ends.
    """

    u: Array
    costs: Array
    cost: float
    objective: float
    penetration_m: float
    overlap_m: float
    side: float
    contact_miss_m: float
    torque_share: float
    lag_share: float
    limit_share: float
    joint_step_rad: float
    hands_base: Array


def judge_basins(follower: Follower, motions: Sequence[Motion], basins: Array, refine: bool = True) -> list[Basin]:
    """Follow each basin through whole demonstrations; best first.

    Args:
        motions: the demonstrations; their `u0` is replaced by what each basin is there.
        basins: (K, m) frame-0 solutions.
        refine: carry contact over too.
    """
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        pairs = [(motion, u0) for u0 in basins for motion in motions]
        tracks = follower.follow_all(list(pool.map(lambda pair: follower.started(*pair), pairs)), refine)
        each = [tracks[i * len(motions) : (i + 1) * len(motions)] for i in range(len(basins))]
        judged = list(pool.map(lambda x: judge(follower, motions, *x), zip(basins, each, strict=True)))
    return ranked(judged)


def ranked(basins: Sequence[Basin]) -> list[Basin]:
    """Basins, best first: a demonstration counts at most what it costs to go another way, so that one that goes badly wrong does not rule out
    what is best for all others.

    Args:
        basins: judged on the same demonstrations.
    """
    another_way = np.min([basin.costs for basin in basins], axis=0) + ANOTHER_WAY_M
    judged = [replace(basin, cost=float(np.minimum(basin.costs, another_way).mean())) for basin in basins]
    return sorted(judged, key=lambda basin: (basin.cost, basin.costs.mean()))


def choose_modes(basins: Sequence[Basin], modes: int) -> list[Basin]:
    """The best basin, then the best whose hands do something else than those chosen, all the way.

    Args:
        basins: judged, best first.
        modes: how many are wanted.

    Raises:
        CEIError: there are fewer that are as free of penetration and nearly as close as the best.
    """
    first, *further = (kind[0] for kind in kinds(basins))
    # Demonstrations of a further mode go no other way than its own.
    chosen = [first, *(each for each in further if each.costs.mean() - first.cost < _WORSE_M)][:modes]
    if len(chosen) < modes:
        raise CEIError(
            f"init.modes={modes}, but only {len(chosen)} distinct good motions were found, whose hands are "
            f"{np.degrees(_APART_RAD):.0f} degrees or {_APART_M:g} m apart; ask for fewer, or raise init.starts (init.draws with eis) and init.basins."
        )
    return chosen


def kinds(basins: Sequence[Basin]) -> list[list[Basin]]:
    """Basins by what their hands do, best first: those of a kind are like its best where motions start, or where they end."""
    found: list[list[Basin]] = []
    for basin in basins:
        like = [kind for kind in found if not are_apart(kind[0], basin)]
        if like:
            like[0].append(basin)
        else:
            found.append([basin])
    return found


def are_apart(one: Basin, other: Basin) -> bool:
    """Whether their hands differ, both as motions start and as they end."""
    A, B = one.hands_base, other.hands_base
    turned_rad = (Rotation.from_matrix(A[:, :3, :3]) * Rotation.from_matrix(B[:, :3, :3]).inv()).magnitude()
    away_m = np.linalg.norm(A[:, :3, 3] - B[:, :3, 3], axis=1)
    return bool(((turned_rad > _APART_RAD) | (away_m > _APART_M)).all())


def judge(follower: Follower, motions: Sequence[Motion], u0: Array, tracks: Sequence[Track]) -> Basin:
    """What a basin's tracks of demonstrations cost; `cost` is the mean of all of it, as if there were no other way."""
    each = [_judge(follower, motion, u0, track) for motion, track in zip(motions, tracks, strict=True)]
    worst = {name: max(getattr(basin, name) for basin in each) for name in _WORST}
    means = {name: float(np.mean([getattr(basin, name) for basin in each])) for name in _MEANS}
    return replace(each[0], costs=np.concatenate([basin.costs for basin in each]), **worst, **means)


def _judge(follower: Follower, motion: Motion, u0: Array, track: Track) -> Basin:
    """What it does in one demonstration."""
    embodiment = follower.problem.embodiment
    lower, upper = embodiment.independent_limits
    arm = embodiment.coupled.independent < embodiment.n_arm
    near = np.minimum(track.u - lower, upper - track.u) < _NEAR_LIMIT_RAD
    moved = np.abs(np.diff(track.u, axis=0))
    lag = 0.0
    if motion.dt_s and follower.options.velocity_scale > 0:
        fastest = embodiment.independent_max_velocity * motion.dt_s * follower.options.velocity_scale
        lag = float(np.any(moved > 0.999 * fastest, axis=1).sum()) / len(track.u)
    qpos = embodiment.coupled.expand(track.u[:: max(1, len(track.u) // _CHECKED_FRAMES)])
    support_z = motion.surroundings.support_z_base_m if motion.surroundings else -np.inf
    penetration, torque = follower.clearance.worst(qpos, support_z)
    overlap = float(follower.overlap_m(motion, track.u).max())
    side = miss = 0.0
    if motion.grip is not None:
        side = _side(follower.problem, motion, track)
        if track.contact_miss_m is not None:
            held = motion.grip.held if motion.grip.held.any() else np.ones(len(track.u), bool)
            miss = float(track.contact_miss_m[held].mean())
    objective, limits = float(track.objective.mean()), float(near[:, arm].any(axis=1).mean())
    cost = objective + _PENETRATION_WEIGHT * penetration + _TORQUE_WEIGHT * max(0.0, torque - _TORQUE_SHARE)
    cost += _OVERLAP_WEIGHT * overlap + _MISS_WEIGHT * miss + _SIDE_WEIGHT * side
    cost += _LAG_WEIGHT * lag + _MARGIN_WEIGHT * limits
    step = float(moved.max(initial=0.0))
    hands = follower.problem.tree.forward(embodiment.coupled.expand(track.u[[0, -1]]))[:, embodiment.end_effector_root]
    costs = np.array([cost])
    return Basin(u0, costs, cost, objective, penetration, overlap, side, miss, torque, lag, limits, step, hands)


def _side(problem: AlignmentProblem, motion: Motion, track: Track) -> float:
    """How far hands are on opposite sides of pads: half of 1 less the cosine between the ways from their first links to the pads' middle, in the
    mean over the frames that are checked."""
    assert motion.grip is not None
    frames = slice(None, None, max(1, len(track.u) // _CHECKED_FRAMES))
    T_links = problem.tree.forward(problem.embodiment.coupled.expand(track.u[frames]))
    points, _ = problem.representation.place(T_links)
    target = points.mean(axis=1) - T_links[:, problem.embodiment.end_effector_root, :3, 3]
    source = motion.points_base[frames].mean(axis=1) - motion.grip.position[frames]
    cosine = np.einsum("ti,ti->t", target, source)
    cosine /= np.maximum(np.linalg.norm(target, axis=1) * np.linalg.norm(source, axis=1), 1e-9)
    return float((1 - cosine).mean() / 2)
