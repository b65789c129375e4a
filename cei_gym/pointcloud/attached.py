"""What a hand has with it all the time, a tool or what a mask has left of the robot: it is near the hand, and in nobody's way."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from cei_gym.arrays import Array
from cei_gym.pointcloud.thin import first_of_voxels

_KEYFRAMES = 8
_MOVED_M = 0.05  # how far apart two frames' hands are, that one tells what goes with the hand from what stays
_SAME_M = 0.01
_MOSTLY = 0.75  # of such frames; what is picked up on the way is with the hand in fewer
_VOXEL_M = 0.005
_FEWEST = 10  # points: fewer are noise that met itself


def attached(scenes: Sequence[Array], T_hand: Array, centre: Array, free: Array, radius_m: float) -> list[Array]:
    """Which points go with the hand although it holds nothing.

    A point of a keyframe does if in three quarters of the other keyframes whose hand is elsewhere there is a point at the same place of
    the hand, and none at the same place of the world.

    Args:
        scenes: for each of T frames (P, 3) points on objects, m.
        T_hand: (T, 4, 4) pose of the hand, same frame of reference.
        centre: (T, 3) of the hand, same frame of reference.
        free: (T,) whether the hand holds nothing that is known of: only these frames tell.
        radius_m: how near the hand is looked.

    Returns:
        For each frame (P,) bool.
    """
    nothing = [np.zeros(len(points), dtype=bool) for points in scenes]
    frames = np.flatnonzero(free)
    if len(frames) < 2:
        return nothing
    keys = frames[np.unique(np.linspace(0, len(frames) - 1, _KEYFRAMES).round().astype(int))]
    near = [scenes[t][np.linalg.norm(scenes[t] - centre[t], axis=1) < radius_m] for t in keys]
    near = [points[first_of_voxels(points, _VOXEL_M)] for points in near]
    if sum(map(len, near)) == 0:
        return nothing
    hands = T_hand[keys]
    local = [_into(T, points) for T, points in zip(hands, near, strict=True)]
    at_hand, in_world = [_tree(points) for points in local], [_tree(scenes[int(t)]) for t in keys]
    apart = np.linalg.norm(hands[:, None, :3, 3] - hands[None, :, :3, 3], axis=-1) > _MOVED_M
    tool = []
    for i, (points, mine) in enumerate(zip(near, local, strict=True)):
        others = [int(j) for j in np.flatnonzero(apart[i])]
        if others:
            votes = np.sum([_has(at_hand[j], mine) & ~_has(in_world[j], points) for j in others], axis=0)
            tool.append(mine[votes >= _MOSTLY * len(others)])
    model = np.concatenate(tool) if tool else np.zeros((0, 3))
    if len(model) < _FEWEST:
        return nothing
    tree = _tree(model)
    return [_has(tree, _into(T, points)) for T, points in zip(T_hand, scenes, strict=True)]


def _tree(cloud: Array) -> KDTree | None:
    return KDTree(cloud) if len(cloud) else None


def _into(T: Array, points: Array) -> Array:
    """(P, 3) points in the frame whose (4, 4) pose is given."""
    return (points - T[:3, 3]) @ T[:3, :3]


def _has(cloud: KDTree | None, points: Array) -> Array:
    """(P,) whether a cloud has a point where each of (P, 3) is; None has none."""
    if cloud is None or not len(points):
        return np.zeros(len(points), dtype=bool)
    return cloud.query(points, distance_upper_bound=_SAME_M)[0] < np.inf
