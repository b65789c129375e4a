"""A readable picture from depth and geom ids, for films and tables where no graphics library exists."""

import numpy as np

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.rendering.pinhole import camera_points

_BACKGROUND = (0.93, 0.94, 0.96)
_SHEEN = 0.12  # keeps the shape of black parts visible


def shade(depth_m: Array, geom_id: Array, camera: Camera, rgba_per_geom: Array) -> Array:
    """Lambert shading under a headlight and a lamp overhead, with normals taken from the depth.

    Args:
        depth_m: (H, W) metres.
        geom_id: (H, W) ids, -1 for background.
        camera: the camera that took them.
        rgba_per_geom: (ngeom, 4) in [0, 1], see `geom_colours`.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    points_camera = camera_points(depth_m, camera)
    normal = np.cross(_slope(points_camera, geom_id, 1), _slope(points_camera, geom_id, 0))
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    toward_eye = -points_camera / np.maximum(np.linalg.norm(points_camera, axis=-1, keepdims=True), 1e-12)
    facing = np.einsum("hwi,hwi->hw", normal, toward_eye)
    normal *= np.where(facing < 0, -1.0, 1.0)[..., None]
    up_camera = camera.T_world_camera[2, :3]
    light = 0.25 + 0.5 * np.abs(facing) + 0.25 * np.maximum(normal @ up_camera, 0.0)
    colour = (rgba_per_geom[geom_id, :3] * (1 - _SHEEN) + _SHEEN) * light[..., None]
    colour[geom_id < 0] = _BACKGROUND
    return (np.clip(colour, 0, 1) * 255).round().astype(np.uint8)


def _slope(points: Array, geom_id: Array, axis: int) -> Array:
    """(H, W, 3) step from or to a neighbour: the one on the same geom, or of less change in depth."""
    step = np.diff(points, axis=axis)
    cost = np.abs(step[..., 2]) + 1e3 * (np.diff(geom_id, axis=axis) != 0)
    shape = list(geom_id.shape)
    shape[axis] = 1
    wall, still = np.full(shape, np.inf), np.zeros([*shape, 3])
    cost_ahead, cost_behind = np.concatenate([cost, wall], axis), np.concatenate([wall, cost], axis)
    ahead, behind = np.concatenate([step, still], axis), np.concatenate([still, step], axis)
    return np.where((cost_ahead <= cost_behind)[..., None], ahead, behind)
