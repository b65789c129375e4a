"""What stands near a hand, seen or not: a hand hides the very things that it must not touch."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from cei_gym.arrays import Array
from cei_gym.pointcloud.thin import first_of_voxels

_VOXEL_M = 0.008
_SAME_M = 0.012  # a remembered point this near to one that is seen is that point


def remember(scenes: Sequence[Array], centre: Array, moved: Array, radius_m: float) -> list[Array]:
    """For each frame the points near a hand, with those that it hides where they were seen last.

    A point that vanishes near the hand is taken to be hidden, not gone, unless the hand moves something.

    Args:
        scenes: for each of T frames (P, 3) points on objects, m.
        centre: (T, 3) of the hand, same frame of reference.
        moved: (T,) whether the hand moves what it holds: what was remembered is then forgotten.
        radius_m: how near is near.

    Returns:
        For each frame (Q, 3) points, one a voxel of 8 mm.
    """
    remembered = np.zeros((0, 3))
    frames = []
    for points, hand, moving in zip(scenes, centre, moved, strict=True):
        near = points[np.linalg.norm(points - hand, axis=1) < radius_m]
        seen = near[first_of_voxels(near, _VOXEL_M)]
        hidden = remembered[np.linalg.norm(remembered - hand, axis=1) < radius_m]
        if moving:
            hidden = hidden[:0]
        elif len(seen) and len(hidden):
            hidden = hidden[KDTree(seen).query(hidden)[0] > _SAME_M]
        remembered = np.concatenate([seen, hidden])
        frames.append(remembered)
    return frames
