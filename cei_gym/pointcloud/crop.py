"""Keeps the workspace (paper, section IV-C: "remove points that lie outside the defined workspace")."""

import numpy as np

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.errors import CEIError


def crop(points_world: Array, workspace_world: Array) -> Array:
    """Which points lie in a box, its faces included; points with an entry that is not finite do not.

    Args:
        points_world: (N, 3) metres, or (N, 6) with colours.
        workspace_world: (2, 3) lower and upper corner, metres.

    Returns:
        (N,) bool.

    Raises:
        CEIError: the box is not (2, 3), or a lower corner is above its upper one.
    """
    workspace_world = np.asarray(workspace_world, dtype=np.float64)
    if workspace_world.shape != (2, 3) or not (workspace_world[0] <= workspace_world[1]).all():
        raise CEIError(f"a workspace is a lower and an upper corner, not {workspace_world.tolist()}.")
    inside = np.empty(len(points_world), dtype=bool)
    _crop(points_world, workspace_world, inside)
    return inside


@njit(cache=True, nogil=True)
def _crop(points, box, inside):
    for n in range(len(points)):
        kept = True
        for axis in range(3):
            kept &= box[0, axis] <= points[n, axis] <= box[1, axis]
        for extra in range(3, points.shape[1]):
            kept &= np.isfinite(points[n, extra])
        inside[n] = kept
