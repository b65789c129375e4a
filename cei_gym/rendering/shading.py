"""A readable picture from depth and geom ids, for films and tables where no graphics library exists."""

import mujoco
import numpy as np

from cei_gym.demonstration import Camera
from cei_gym.rendering.pinhole import camera_points

_BACKGROUND = (0.93, 0.94, 0.96)
_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)
_SHEEN = 0.12  # keeps the shape of black parts visible


def geom_colours(model: mujoco.MjModel) -> np.ndarray:
    """(ngeom, 4) RGBA in [0, 1]: a geom's own colour, else its material's, times its texture's mean.

    MuJoCo's rule: a geom shows its material, if it has one, unless its own colour is not the default grey.
    """
    material_rgba = model.mat_rgba.copy()
    for material, texture in enumerate(model.mat_texid[:, mujoco.mjtTextureRole.mjTEXROLE_RGB]):
        if texture >= 0:
            channels = model.tex_nchannel[texture]
            size = model.tex_height[texture] * model.tex_width[texture] * channels
            texels = model.tex_data[model.tex_adr[texture] :][:size].reshape(-1, channels)
            material_rgba[material, :3] *= texels[:, :3].mean(axis=0) / 255
    rgba = model.geom_rgba.copy()
    shows_material = (model.geom_matid >= 0) & (rgba == _DEFAULT_RGBA).all(axis=1)
    rgba[shows_material] = material_rgba[model.geom_matid[shows_material]]
    return rgba


def shade(depth_m: np.ndarray, geom_id: np.ndarray, camera: Camera, rgba_per_geom: np.ndarray) -> np.ndarray:
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


def _slope(points: np.ndarray, geom_id: np.ndarray, axis: int) -> np.ndarray:
    """(H, W, 3) step from or to a neighbour: the one on the same geom, or of less change in depth."""
    step = np.diff(points, axis=axis)
    cost = np.abs(step[..., 2]) + 1e3 * (np.diff(geom_id, axis=axis) != 0)
    shape = list(geom_id.shape)
    shape[axis] = 1
    wall, still = np.full(shape, np.inf), np.zeros([*shape, 3])
    cost_ahead, cost_behind = np.concatenate([cost, wall], axis), np.concatenate([wall, cost], axis)
    ahead, behind = np.concatenate([step, still], axis), np.concatenate([still, step], axis)
    return np.where((cost_ahead <= cost_behind)[..., None], ahead, behind)
