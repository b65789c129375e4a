"""Surfaces of an embodiment's links as trimesh, in the link's frame, metres."""

from collections.abc import Iterable
from functools import cache
from typing import cast

import mujoco
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.embodiment.colours import geom_colours
from cei_gym.errors import CEIError

_OUTERMOST = (
    512  # directions in which a link keeps its outermost vertices: within 2 mm of all of them against any plane
)


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Closed surface of one geom in the frame of its body.

    Raises:
        CEIError: a kind of geom with no surface of its own (plane, height field, signed distance field).
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    shapes = mujoco.mjtGeom
    if kind == shapes.mjGEOM_MESH:
        mesh = _compiled_mesh(model, model.geom_dataid[geom])
    elif kind == shapes.mjGEOM_BOX:
        mesh = trimesh.creation.box(extents=2 * size)
    elif kind == shapes.mjGEOM_SPHERE:
        mesh = trimesh.creation.icosphere(subdivisions=4, radius=size[0])
    elif kind == shapes.mjGEOM_ELLIPSOID:
        mesh = trimesh.creation.icosphere(subdivisions=4).apply_scale(size)
    elif kind == shapes.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(radius=size[0], height=2 * size[1])
    elif kind == shapes.mjGEOM_CAPSULE:
        mesh = trimesh.creation.capsule(radius=size[0], height=2 * size[1])
    else:
        raise CEIError(f"geom {model.geom(geom).name!r} has no surface to sample (type {kind}).")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(model.geom_quat[geom], scalar_first=True).as_matrix()
    T[:3, 3] = model.geom_pos[geom]
    return mesh.apply_transform(T)


def geom_vertices(model: mujoco.MjModel, geom: int) -> Array:
    """(V, 3) vertices of `geom_mesh`; of a mesh as they are compiled, which takes a tenth of the time."""
    if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
        return np.asarray(geom_mesh(model, geom).vertices)
    mesh = model.geom_dataid[geom]
    first = model.mesh_vertadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)
    R = Rotation.from_quat(model.geom_quat[geom], scalar_first=True).as_matrix()
    return vertices @ R.T + model.geom_pos[geom]


def link_mesh(model: mujoco.MjModel, geoms: Iterable[int]) -> trimesh.Trimesh | None:
    """Several geoms of one body as one surface in the body's frame, faces in their colours; None if there are none."""
    meshes, rgba = [], geom_colours(model)
    for geom in geoms:
        meshes.append(geom_mesh(model, geom))
        meshes[-1].visual.face_colors = rgba[geom]
    return cast(trimesh.Trimesh, trimesh.util.concatenate(meshes)) if meshes else None


def visual_geoms(model: mujoco.MjModel) -> Array:
    """(ngeom,) bool: what a camera sees, a body's visual geoms, or its collision geoms where it has none."""
    visual = (model.geom_contype == 0) & (model.geom_conaffinity == 0)
    has_visual = np.bincount(model.geom_bodyid, visual, model.nbody) > 0
    return visual | ~has_visual[model.geom_bodyid]


def visual_link_meshes(model: mujoco.MjModel) -> list[trimesh.Trimesh | None]:
    """What a camera sees of each of the L bodies (see `visual_geoms`)."""
    seen = visual_geoms(model)
    return [link_mesh(model, np.flatnonzero(seen & (model.geom_bodyid == body))) for body in range(model.nbody)]


def collision_geoms(model: mujoco.MjModel, body: int) -> Array:
    """Indices of a body's geoms that can touch something."""
    geoms = np.flatnonzero(model.geom_bodyid == body)
    return geoms[(model.geom_contype[geoms] != 0) | (model.geom_conaffinity[geoms] != 0)]


def _compiled_mesh(model: mujoco.MjModel, mesh: int) -> trimesh.Trimesh:
    vertices = slice(model.mesh_vertadr[mesh], model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh])
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    return trimesh.Trimesh(model.mesh_vert[vertices].astype(float), model.mesh_face[faces], process=True)


def outermost(vertices: Array) -> Array:
    """The vertices (V, 3) that lie farthest out in evenly spread directions: enough to tell which touches a plane."""
    heights = spread_directions(_OUTERMOST) @ vertices.T  # with vertices last, as numpy searches rows six times as fast
    return vertices[np.unique(heights.argmax(axis=1))]


@cache
def spread_directions(n: int) -> Array:
    """(n, 3) unit vectors evenly spread over the sphere (a golden spiral)."""
    i = np.arange(n) + 0.5
    polar, turn = np.arccos(1 - 2 * i / n), np.pi * (1 + 5**0.5) * i
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
