"""Points drawn into a finished picture, hidden by what stands before them."""

import numpy as np

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.rendering.pinhole import project

_ON_SURFACE_M = 0.004  # a point this far behind a surface is on it


def splat(
    picture: Array,
    depth_m: Array,
    camera: Camera,
    points_world: Array,
    rgb: Array,
    radius_px: float,
) -> None:
    """Draw points as discs, in place, the nearer over the farther.

    Args:
        picture: (H, W, 3) uint8.
        depth_m: (H, W) depth of what is drawn already, 0 where nothing is; discs are not added to it.
        camera: that took it.
        points_world: (N, 3) m; those that are not finite or not in view are left out.
        rgb: (N, 3) or (3,) in [0, 255].
        radius_px: of the discs.
    """
    pixels, z = project(points_world, camera)
    seen = np.flatnonzero(pixels[:, 0] >= 0)
    order = seen[np.argsort(-z[seen])]  # far to near: the last one to be drawn stays
    reach = np.arange(-int(radius_px), int(radius_px) + 1)
    disc = np.array([(v, u) for v in reach for u in reach if np.hypot(v, u) <= radius_px])
    row, column = (pixels[order, None] + disc).reshape(-1, 2).T
    z = np.repeat(z[order], len(disc))
    colours = np.repeat(np.broadcast_to(rgb, points_world.shape)[order], len(disc), axis=0)
    inside = (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
    row, column, z, colours = row[inside], column[inside], z[inside], colours[inside]
    free = (depth_m[row, column] == 0) | (z < depth_m[row, column] + _ON_SURFACE_M)
    picture[row[free], column[free]] = colours[free]
