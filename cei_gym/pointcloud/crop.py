"""Keeps the workspace (paper, section IV-C: "remove points that lie outside the defined workspace")."""

import numpy as np

from cei_gym.errors import CEIError


def crop(points_world: np.ndarray, workspace_world: np.ndarray) -> np.ndarray:
    """Which points lie in a box, its faces included; points that are not finite do not.

    Args:
        points_world: (N, 3) metres.
        workspace_world: (2, 3) lower and upper corner, metres.

    Returns:
        (N,) bool.

    Raises:
        CEIError: the box is not (2, 3), or a lower corner is above its upper one.
    """
    workspace_world = np.asarray(workspace_world)
    if workspace_world.shape != (2, 3) or not (workspace_world[0] <= workspace_world[1]).all():
        raise CEIError(f"a workspace is a lower and an upper corner, not {workspace_world.tolist()}.")
    lower, upper = workspace_world
    inside = np.isfinite(points_world[:, 0])
    for axis in range(3):  # three passes over columns are faster than `all` over rows of three
        inside &= (points_world[:, axis] >= lower[axis]) & (points_world[:, axis] <= upper[axis])
    return inside
