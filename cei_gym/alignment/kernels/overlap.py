"""How deep a trajectory's links are in objects, compiled."""

import numpy as np

from cei_gym.alignment.kernels.collision import at_frame, nearest
from cei_gym.alignment.kernels.distance import place_joints
from cei_gym.alignment.kernels.target import empty_pose
from cei_gym.compiled import njit


@njit(cache=True, nogil=True)
def overlaps(target, away, pads, around, elsewhere, u):
    """(T,) how deep links are in points at (T, m) configurations, m, and (T,) which link is deepest; points as for `refine`."""
    pose = empty_pose(target, 1)
    deepest, which = np.zeros(len(u)), np.zeros(len(u), np.int64)
    point, normal = np.empty(3), np.empty(3)
    for t in range(len(u)):
        place_joints(target, u[t], pose)
        for links, points in (
            (away, at_frame(around, t)),
            (pads, at_frame(elsewhere, t)),
        ):
            for link in range(len(links.joint)):
                if links.idle[link]:
                    distance = nearest(links, link, points, pose, links.joint[link], 0.0, point, normal)
                    if -distance > deepest[t]:
                        deepest[t], which[t] = -distance, links.body[link]
    return deepest, which
