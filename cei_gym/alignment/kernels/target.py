"""The target and the source's frame as arrays for compiled code."""

from typing import NamedTuple

import numpy as np

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.functional.representation import FunctionalRepresentation
from cei_gym.kinematics.joints import JointTree, reduce_to_joints
from cei_gym.kinematics.tree import KinematicTree

FINITE = {"nnan", "ninf"}
"""What the compiler may assume of numbers (`fastmath`), so that loops become wide instructions. It may not put sums in an order of its own,
or fuse them: they would be others in another process, as LLVM inlines what it compiles otherwise than what it finds in the cache."""


class Target(NamedTuple):
    """Joints, coupling `q = scale * u[leader] + offset` and pads of the target.

    Attributes:
        joints: those that move a pad (or all).
        leader, scale, offset: (n,) coupling of these joints to the m independent ones.
        pad_joint: (N',) index of the joint whose frame carries a pad pair, or -1 for the base.
        pads: (N', 6) points (m) and unit normals in that frame.
        lower, upper: (m,) limits of the independent joints.
        fastest: (m,) largest speed of the independent joints, rad/s or m/s.
    """

    joints: JointTree
    leader: Array
    scale: Array
    offset: Array
    pad_joint: Array
    pads: Array
    lower: Array
    upper: Array
    fastest: Array


def make_target(representation: FunctionalRepresentation, tree: KinematicTree, all_joints: bool = False) -> Target:
    """The target's arrays; joints that move no pad are left out unless `all_joints`."""
    embodiment: Embodiment = representation.embodiment
    joints, bodies = reduce_to_joints(tree.arrays)
    R, t = bodies.rot[representation.body], bodies.pos[representation.body]
    points = np.einsum("nij,nj->ni", R, representation.points_link) + t
    normals = np.einsum("nij,nj->ni", R, representation.normals_link)
    pad_joint = bodies.joint[representation.body]
    used = all_joints | tree.moving(representation.body)
    new_index = np.append(np.cumsum(used) - 1, -1)  # the base, -1, stays the base
    coupled = embodiment.coupled
    lower, upper = embodiment.independent_limits
    return Target(
        joints=JointTree(new_index[joints.parent][used], *(x[used] for x in joints[1:])),
        leader=coupled.leader[used].astype(np.int64),
        scale=coupled.scale[used],
        offset=coupled.offset[used],
        pad_joint=new_index[pad_joint],
        pads=np.concatenate([points, normals], axis=1),
        lower=lower,
        upper=upper,
        fastest=embodiment.independent_max_velocity,
    )


class Source(NamedTuple):
    """One frame of the source's representation about its centroid, components first for wide arithmetic.

    Attributes:
        origin: (3,) centroid in the target's base frame.
        pairs: (6, N) points minus origin, and normals.
        pairs32: the same in single precision.
        radius: (1,) farthest point from the origin, m.
    """

    origin: Array
    pairs: Array
    pairs32: Array
    radius: Array


@njit(cache=True, nogil=True)
def empty_source(n):
    return Source(np.empty(3), np.empty((6, n)), np.empty((6, n), np.float32), np.empty(1))


@njit(cache=True, nogil=True)
def load_source(points, normals, source):
    """Fill `source` with one frame, (N, 3) each."""
    origin, pairs, pairs32 = source.origin, source.pairs, source.pairs32
    origin[:] = 0.0
    for k in range(len(points)):
        for i in range(3):
            origin[i] += points[k, i] / len(points)
    for k in range(len(points)):
        for i in range(3):
            pairs[i, k], pairs[3 + i, k] = points[k, i] - origin[i], normals[k, i]
            pairs32[i, k], pairs32[3 + i, k] = pairs[i, k], normals[k, i]
    source.radius[0] = radius(pairs)


@njit(cache=True, nogil=True, fastmath=FINITE)
def radius(pairs):
    """Largest distance of (6, N) pairs' points from the origin, m."""
    largest = 0.0
    for j in range(pairs.shape[1]):
        squared = pairs[0, j] ** 2 + pairs[1, j] ** 2 + pairs[2, j] ** 2
        largest = squared if squared > largest else largest
    return np.sqrt(largest)


class Pose(NamedTuple):
    """The target at one configuration, and which pairs match there.

    Attributes:
        rot, pos, axis: (n, 3, 3), (n, 3), (n, 3) joint frames and axes in the base frame.
        pairs: (6, N') pads about the source's origin.
        pairs32: the same in single precision.
        match: (N,) target pair of each source pair.
        match_back: (N',) source pair of each target pair.
        keys: (N',) scratch of the matching.
        radius: (1,) farthest pad from the source's origin, m.
    """

    rot: Array
    pos: Array
    axis: Array
    pairs: Array
    pairs32: Array
    match: Array
    match_back: Array
    keys: Array
    radius: Array


@njit(cache=True, nogil=True)
def empty_pose(target, n_source):
    joints, pads = len(target.leader), len(target.pads)
    return Pose(
        np.empty((joints, 3, 3)),
        np.empty((joints, 3)),
        np.empty((joints, 3)),
        np.empty((6, pads)),
        np.empty((6, pads), np.float32),
        np.empty(n_source, np.int32),
        np.empty(pads, np.int32),
        np.empty(pads, np.int32),
        np.empty(1),
    )
