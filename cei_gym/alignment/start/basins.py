"""Which frame-0 solution to follow: the one whose whole trajectories cost least.

Solutions within a millimetre of each other in objective can put a hand into its own forearm or under the table, which shows
only later in the episode, so candidates are judged by following whole demonstrations.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from cei_gym.alignment.follow import Follower
from cei_gym.alignment.problem import Motion, Track
from cei_gym.arrays import Array
from cei_gym.errors import CEIError

_PENETRATION_WEIGHT = 1.0  # metres of objective a metre of penetration
_OVERLAP_WEIGHT = 0.5  # metres of objective a metre that a link is in an object
_MISS_WEIGHT = 1.0  # metres of objective a metre between contact points and the source's
_TORQUE_WEIGHT = 0.3  # metres of objective for static torque a full limit above the allowed share: such an arm sinks
_TORQUE_SHARE = 0.8
_LAG_WEIGHT = 0.05  # metres of objective if some joint moves as fast as it can in all frames
_MARGIN_WEIGHT = 0.01  # metres of objective if some arm joint is near a limit in all frames
_NEAR_LIMIT_RAD = 0.05
_APART_RAD = 0.5  # some joint of two modes differs by this much
_WORSE_M = 0.01  # how much more than the best a further mode may cost
_CHECKED_FRAMES = 20  # of each demonstration, for penetration and torque


@dataclass(frozen=True)
class Basin:
    """A frame-0 solution and what following it through demonstrations costs.

    Attributes:
        u: (m,) independent joints at frame 0, rad or m.
        cost: metres; mean objective plus penalties (lower is better).
        objective: metres; mean DCD over the demonstrations.
        penetration_m: deepest contact of the target with itself, the support surface or its stand.
        overlap_m: deepest a link is in an object that the cloud shows, but for pads in what is gripped.
        contact_miss_m: how far contact points are from the source's while it holds something, in the mean.
        torque_share: largest static joint torque as a share of its limit.
        lag_share: share of frames in which a joint moves as fast as it can.
        limit_share: share of frames in which an arm joint is near one of its limits.
        joint_step_rad: largest joint step between frames.
        u_last: (m,) independent joints where the first demonstration ends, rad or m.
    """

    u: Array
    cost: float
    objective: float
    penetration_m: float
    overlap_m: float
    contact_miss_m: float
    torque_share: float
    lag_share: float
    limit_share: float
    joint_step_rad: float
    u_last: Array


def judge_basins(follower: Follower, motions: Sequence[Motion], basins: Array, refine: bool = True) -> list[Basin]:
    """Follow each basin through whole demonstrations; best first.

    Args:
        motions: the demonstrations; their `u0` is replaced by each basin.
        basins: (K, m) frame-0 solutions.
        refine: carry contact over too.
    """
    tracks = follower.follow_all([replace(motion, u0=u0) for u0 in basins for motion in motions], refine)
    each = [tracks[i * len(motions) : (i + 1) * len(motions)] for i in range(len(basins))]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        judged = list(pool.map(lambda x: judge(follower, motions, *x), zip(basins, each, strict=True)))
    return sorted(judged, key=lambda b: b.cost)


def choose_modes(basins: Sequence[Basin], modes: int) -> list[Basin]:
    """The best basin, then the best that differ from those chosen where motions start and still where they end.

    Args:
        basins: judged, best first.
        modes: how many are wanted.

    Raises:
        CEIError: there are fewer that are as free of penetration and nearly as close as the best.
    """

    def apart(a: Basin, b: Basin) -> bool:
        return min(np.abs(a.u - b.u).max(), np.abs(a.u_last - b.u_last).max()) > _APART_RAD

    chosen = [basins[0]]
    for basin in basins[1:]:
        valid = basin.cost - basins[0].cost < _WORSE_M
        if len(chosen) < modes and valid and all(apart(basin, other) for other in chosen):
            chosen.append(basin)
    if len(chosen) < modes:
        raise CEIError(
            f"init.modes={modes}, but only {len(chosen)} distinct good motions were found; ask for fewer, or raise "
            "init.starts and init.basins."
        )
    return chosen


def judge(follower: Follower, motions: Sequence[Motion], u0: Array, tracks: Sequence[Track]) -> Basin:
    """What a basin's tracks cost."""
    embodiment = follower.problem.embodiment
    lower, upper = embodiment.independent_limits
    arm = embodiment.coupled.independent < embodiment.n_arm
    u = np.concatenate([t.u for t in tracks])
    near = np.minimum(u - lower, upper - u) < _NEAR_LIMIT_RAD
    step, lag, penetration, overlap, torque = 0.0, 0, 0.0, 0.0, 0.0
    missed = []
    for motion, track in zip(motions, tracks, strict=True):
        moved = np.abs(np.diff(track.u, axis=0))
        step = max(step, float(moved.max(initial=0.0)))
        if motion.dt_s and follower.options.velocity_scale > 0:
            fastest = embodiment.independent_max_velocity * motion.dt_s * follower.options.velocity_scale
            lag += int(np.any(moved > 0.999 * fastest, axis=1).sum())
        qpos = embodiment.coupled.expand(track.u[:: max(1, len(track.u) // _CHECKED_FRAMES)])
        support_z = motion.surroundings.support_z_base_m if motion.surroundings else -np.inf
        deepest, hardest = follower.clearance.worst(qpos, support_z)
        overlap = max(overlap, float(follower.overlap_m(motion, track.u).max()))
        if track.contact_miss_m is not None and motion.grip is not None:
            held = motion.grip.held if motion.grip.held.any() else np.ones(len(track.u), bool)
            missed.append(track.contact_miss_m[held].mean())
        penetration, torque = max(penetration, deepest), max(torque, hardest)
    objective = float(np.mean(np.concatenate([t.objective for t in tracks])))
    lag_share, limit_share = lag / len(u), float(near[:, arm].any(axis=1).mean())
    cost = objective + _PENETRATION_WEIGHT * penetration + _TORQUE_WEIGHT * max(0.0, torque - _TORQUE_SHARE)
    miss = float(np.mean(missed)) if missed else 0.0
    cost += _OVERLAP_WEIGHT * overlap + _MISS_WEIGHT * miss
    cost += _LAG_WEIGHT * lag_share + _MARGIN_WEIGHT * limit_share
    return Basin(u0, cost, objective, penetration, overlap, miss, torque, lag_share, limit_share, step, tracks[0].u[-1])
