"""Unit meshes of MuJoCo's primitive geoms, and the sizes that turn them into the real ones.

A point of a geom, in its frame, is `scale * vertex + shift * (0, 0, cap)`: only capsules have a shift,
because stretching one must not squash its ends. With shape and size apart, an environment may resize a geom
between frames.
"""

from functools import cache

import mujoco
import numpy as np
import trimesh

from cei_gym.arrays import Array
from cei_gym.errors import CEIError

INFINITE_PLANE_HALF_M = 100.0  # what an infinite plane is cut to
_SECTIONS = 96  # around an axis: a chord is at most 0.05 % of the radius off

_Geom = mujoco.mjtGeom
_MESHES = (_Geom.mjGEOM_MESH, _Geom.mjGEOM_SDF)


def is_mesh(kind: int) -> bool:
    """Whether a geom of this type takes its triangles from a mesh asset."""
    return kind in _MESHES


@cache
def unit_shape(kind: int) -> tuple[Array, Array, Array]:
    """Triangles of a primitive of size 1, wound outwards.

    Args:
        kind: an `mjtGeom` value other than a mesh.

    Returns:
        vertices (V, 3) float64, caps (V,) float64 in {-1, 0, 1}, faces (F, 3) int32.

    Raises:
        CEIError: the type has no triangles here (height fields).
    """
    quarter = np.linspace(0.0, np.pi / 2, _SECTIONS // 4 + 1)
    if kind == _Geom.mjGEOM_PLANE:
        corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
        mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    elif kind == _Geom.mjGEOM_BOX:
        mesh = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    elif kind == _Geom.mjGEOM_CYLINDER:
        mesh = trimesh.creation.revolve([[0, -1], [1, -1], [1, 1], [0, 1]], sections=_SECTIONS)
    elif kind in (_Geom.mjGEOM_SPHERE, _Geom.mjGEOM_ELLIPSOID, _Geom.mjGEOM_CAPSULE):
        # A sphere with its equator doubled and its halves apart; a sphere is a capsule that is never shifted.
        upper = np.stack([np.cos(quarter), np.sin(quarter) + 1.0], axis=1)
        upper[-1, 0] = 0.0
        lower = upper[::-1] * (1.0, -1.0)
        mesh = trimesh.creation.revolve(np.concatenate([lower, upper]), sections=_SECTIONS)
    else:
        raise CEIError(f"the depth camera cannot draw geoms of type {_Geom(kind).name}.")
    vertices = np.array(mesh.vertices, dtype=np.float64)
    caps = np.zeros(len(vertices))
    if np.abs(vertices[:, 2]).max() > 1.5:
        caps = np.sign(vertices[:, 2])
        vertices[:, 2] -= caps
    return vertices, caps, np.ascontiguousarray(mesh.faces, dtype=np.int32)


def geom_scale(model: mujoco.MjModel, geom_id: Array) -> tuple[Array, Array]:
    """Current sizes of geoms: scale (G, 3) and shift (G,), metres (a mesh has scale 1)."""
    kind = model.geom_type[geom_id]
    scale = model.geom_size[geom_id].copy()
    shift = np.where(kind == _Geom.mjGEOM_CAPSULE, scale[:, 1], 0.0)
    flat = kind == _Geom.mjGEOM_PLANE
    scale[flat] = np.where(scale[flat] > 0, scale[flat], INFINITE_PLANE_HALF_M)
    cylinder = kind == _Geom.mjGEOM_CYLINDER
    scale[cylinder] = scale[cylinder][:, [0, 0, 1]]
    round_ = np.isin(kind, (_Geom.mjGEOM_SPHERE, _Geom.mjGEOM_CAPSULE))
    scale[round_] = scale[round_, :1]
    scale[np.isin(kind, _MESHES)] = 1.0
    return scale, shift
