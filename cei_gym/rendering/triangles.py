"""The triangles of a MuJoCo model's visible geoms, packed for the rasteriser."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.colours import geom_colours
from cei_gym.errors import CEIError
from cei_gym.rendering.clustering import cluster_vertices, is_closed
from cei_gym.rendering.shapes import is_mesh, unit_shape


@dataclass(frozen=True)
class Triangles:
    """Triangles of G geoms, which may share shapes.

    Attributes:
        geom_id: (G,) int32 ids in the model.
        vertices: (V, 3) float64 points, before `shapes.geom_scale`, in the frames of their geoms.
        caps: (V,) float64, the sign of a capsule's half, else 0.
        faces: (F, 3) int32, counted from the first vertex of the shape.
        vertex_range, face_range: (G, 2) int64 first and past-the-last row of each geom's shape.
        one_sided: (G,) bool, true where backs of triangles need no drawing.
    """

    geom_id: Array
    vertices: Array
    caps: Array
    faces: Array
    vertex_range: Array
    face_range: Array
    one_sided: Array


def visible_geoms(model: mujoco.MjModel, groups: Sequence[int] = (1,)) -> Array:
    """(ngeom,) bool: geoms in these groups (robosuite: 0 collision, 1 visual) that are not transparent."""
    return np.isin(model.geom_group, groups) & (geom_colours(model)[:, 3] > 0)


def collect(model: mujoco.MjModel, selection: Array, cluster_m: float = 0.001) -> Triangles:
    """Packs the triangles of the selected geoms.

    Args:
        model: the model.
        selection: (ngeom,) bool.
        cluster_m: cell of the vertex clustering of meshes, metres; 0 keeps every triangle.

    Raises:
        CEIError: nothing is selected, or a geom is of a type that has no triangles.
    """
    geom_id = np.flatnonzero(selection).astype(np.int32)
    if not len(geom_id):
        raise CEIError("the depth camera has nothing to draw: no geom is in the selected groups.")
    keys = [(int(model.geom_type[g]), int(model.geom_dataid[g])) for g in geom_id]
    shapes = {key: _shape(model, *key, cluster_m) for key in dict.fromkeys(keys)}
    order = {key: i for i, key in enumerate(shapes)}
    which = np.array([order[key] for key in keys])
    vertices, caps, faces, one_sided = zip(*shapes.values(), strict=True)
    return Triangles(
        geom_id=geom_id,
        vertices=np.concatenate(vertices),
        caps=np.concatenate(caps),
        faces=np.concatenate(faces),
        vertex_range=_ranges(vertices)[which],
        face_range=_ranges(faces)[which],
        one_sided=np.array(one_sided)[which],
    )


def _shape(model: mujoco.MjModel, kind: int, mesh_id: int, cluster_m: float) -> tuple[Array, Array, Array, bool]:
    if not is_mesh(kind):
        return *unit_shape(kind), True  # a plane has no back in MuJoCo either
    start, count = model.mesh_vertadr[mesh_id], model.mesh_vertnum[mesh_id]
    vertices = model.mesh_vert[start : start + count].astype(np.float64)
    start, count = model.mesh_faceadr[mesh_id], model.mesh_facenum[mesh_id]
    faces = model.mesh_face[start : start + count].astype(np.int32)
    if cluster_m > 0:
        vertices, faces = cluster_vertices(vertices, faces, cluster_m)
    return vertices, np.zeros(len(vertices)), faces, is_closed(faces)


def _ranges(parts: Sequence[Array]) -> Array:
    ends = np.cumsum([len(part) for part in parts])
    return np.stack([np.concatenate([[0], ends[:-1]]), ends], axis=1).astype(np.int64)
