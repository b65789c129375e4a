"""Which side of a finger is its palm side, and which part of its length is its pad."""

import numpy as np
import trimesh

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.spec import Pad
from cei_gym.errors import CEIError
from cei_gym.kinematics.tree import KinematicTree

_GAP_M = 1e-4
_SAME_LENGTH = 0.95


def palmar_directions(embodiment: Embodiment, tree: KinematicTree, pad: Pad, points_link: Array) -> Array:
    """Unit directions that points of a pad's link move in when the end-effector closes: the palmar side leads.

    Args:
        points_link: (N, 3) points in the pad's link frame, m.

    Returns:
        (N, 3) unit directions in the link's frame; the pad's own `palmar` direction where its YAML gives one.
    """
    if pad.palmar != "auto":
        direction = np.zeros(0) if isinstance(pad.palmar, str) else np.asarray(pad.palmar, float)
        if direction.shape != (3,) or not 0 < np.linalg.norm(direction) < np.inf:
            raise CEIError(f"pad {pad.body!r} of {embodiment.name}: `palmar` is 'auto' or a direction of 3 numbers.")
        return np.broadcast_to(direction / np.linalg.norm(direction), points_link.shape)
    body = embodiment.body_id(pad.body)
    closing = embodiment.closed - embodiment.home
    J = tree.jacobian(embodiment.home, body, np.zeros(3))
    linear, angular = J[:3] @ closing, J[3:] @ closing
    if not np.any(np.abs(linear) + np.abs(angular) > 0):
        raise CEIError(
            f"pad {pad.body!r} of {embodiment.name}: no joint that moves it differs between `home` and `closed`; "
            "give `closed`, or set `palmar`."
        )
    rot = tree.forward(embodiment.home)[body, :3, :3]
    velocity = (linear + np.cross(angular, points_link @ rot.T)) @ rot
    return velocity / np.maximum(np.linalg.norm(velocity, axis=1, keepdims=True), 1e-12)


def extent_mask(mesh: trimesh.Trimesh, extent: list[float], points_link: Array) -> Array:
    """Which points lie in a part of a link's length, measured along its longest principal axis to the tip, its end farther from the
    joint.

    Args:
        mesh: the link's surface in its frame, whose origin is at the joint.
        extent: start and end as fractions of the length.
        points_link: (N, 3) m.
    """
    if (bounds := _extent_bounds_m(mesh, extent)) is None:
        return np.ones(len(points_link), bool)
    axis, start_m, end_m = bounds
    along_m = points_link @ axis
    return (along_m >= start_m) & (along_m <= end_m)


def within_extent(mesh: trimesh.Trimesh, extent: list[float]) -> trimesh.Trimesh:
    """The part of a link's surface that lies in a part of its length, cut open where it ends; see `extent_mask`."""
    if (bounds := _extent_bounds_m(mesh, extent)) is None:
        return mesh
    axis, start_m, end_m = bounds
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    for end, towards in ((start_m, axis), (end_m, -axis)):  # what `slice_plane` does, which wants shapely
        vertices, faces, _ = trimesh.intersections.slice_faces_plane(vertices, faces, towards, end * axis)
    return trimesh.Trimesh(vertices, faces)


def _extent_bounds_m(mesh: trimesh.Trimesh, extent: list[float]) -> tuple[Array, float, float] | None:
    """The axis (3,) that a link's length is measured along, and where on it an extent starts and ends, m; None for all of it.

    Raises:
        CEIError: it is no extent, or either end of the link may be its tip.
    """
    if len(extent) != 2 or not 0 <= extent[0] < extent[1] <= 1:
        raise CEIError(f"a pad's `extent` must be 0 <= start < end <= 1, not {extent}.")
    if tuple(extent) == (0, 1):
        return None
    axis, first_m, last_m = length_axis(mesh)
    ends_m = -first_m, last_m
    if min(ends_m) > _SAME_LENGTH * max(ends_m) and not np.isclose(extent[0] + extent[1], 1):
        raise CEIError(
            f"`extent` {extent}: the link reaches as far to one side of its joint as to the other ({1e3 * ends_m[0]:.1f} and "
            f"{1e3 * ends_m[1]:.1f} mm), so that it does not say which is the tip; name the pad's `geoms` instead."
        )
    start_m, end_m = first_m + np.array(extent) * (last_m - first_m)
    return axis, float(start_m), float(end_m)


def length_axis(mesh: trimesh.Trimesh) -> tuple[Array, float, float]:
    """The axis (3,) of a link's length, unit, to its tip, the end farther from its joint; and where the link begins and ends along it, m.

    Args:
        mesh: the link's surface in its frame, whose origin is at the joint.
    """
    _, _, axes = np.linalg.svd(mesh.vertices - mesh.vertices.mean(0), full_matrices=False)
    along_m = mesh.vertices @ axes[0]
    first_m, last_m = float(along_m.min()), float(along_m.max())
    return (-axes[0], -last_m, -first_m) if -first_m > last_m else (axes[0], first_m, last_m)


def outer_mask(mesh: trimesh.Trimesh, points_link: Array, normals_link: Array) -> Array:
    """Which points lie on the outside of a link: nothing of the link is above them, along their normals.

    Finger meshes are hollow, and the inside of a finger's back has a palmar normal too.

    Args:
        mesh: the link's surface in its frame.
        points_link, normals_link: (N, 3) m and unit.
    """
    triangles = np.ascontiguousarray(mesh.triangles, float)
    return ~_covered(triangles, np.ascontiguousarray(points_link), np.ascontiguousarray(normals_link))


@njit(cache=True, nogil=True)
def _covered(triangles, origins, directions):
    """Which rays meet a triangle farther than a gap from their origin (Moeller and Trumbore).

    trimesh's own ray test needs an optional package and builds a tree that thousands of rays do not pay back.
    """
    covered = np.zeros(len(origins), np.bool_)
    for i in range(len(origins)):
        dx, dy, dz = directions[i]
        for k in range(len(triangles)):
            corner, second, third = triangles[k, 0], triangles[k, 1], triangles[k, 2]
            ax, ay, az = second[0] - corner[0], second[1] - corner[1], second[2] - corner[2]
            bx, by, bz = third[0] - corner[0], third[1] - corner[1], third[2] - corner[2]
            hx, hy, hz = dy * bz - dz * by, dz * bx - dx * bz, dx * by - dy * bx
            det = ax * hx + ay * hy + az * hz
            if det == 0.0:
                continue
            sx, sy, sz = origins[i, 0] - corner[0], origins[i, 1] - corner[1], origins[i, 2] - corner[2]
            u = (sx * hx + sy * hy + sz * hz) / det
            if u < 0.0 or u > 1.0:
                continue
            qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
            v = (dx * qx + dy * qy + dz * qz) / det
            if v >= 0.0 and u + v <= 1.0 and (bx * qx + by * qy + bz * qz) / det > _GAP_M:
                covered[i] = True
                break
    return covered
