"""Colours of a MuJoCo model's geoms."""

import mujoco
import numpy as np

from cei_gym.arrays import Array

_DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], dtype=np.float32)


def geom_colours(model: mujoco.MjModel) -> Array:
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
