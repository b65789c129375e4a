"""Which side of a finger is its palm side, and which part of its length is its pad."""

import numpy as np
import trimesh
from numba import njit

from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.spec import Pad
from cei_gym.errors import CEIError
from cei_gym.kinematics.tree import KinematicTree

_GAP_M = 1e-4


def palmar_directions(embodiment: Embodiment, tree: KinematicTree, pad: Pad, points_link: np.ndarray) -> np.ndarray:
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


def extent_mask(mesh: trimesh.Trimesh, extent: list[float], points_link: np.ndarray) -> np.ndarray:
    """Which points lie in a part of a link's length, measured along its longest principal axis from the joint.

    Args:
        mesh: the link's surface in its frame, whose origin is at the joint.
        extent: start and end as fractions of the length.
        points_link: (N, 3) m.
    """
    if len(extent) != 2 or not 0 <= extent[0] < extent[1] <= 1:
        raise CEIError(f"a pad's `extent` must be 0 <= start < end <= 1, not {extent}.")
    start, end = extent
    if (start, end) == (0, 1):
        return np.ones(len(points_link), bool)
    _, _, axes = np.linalg.svd(mesh.vertices - mesh.vertices.mean(0), full_matrices=False)
    axis = axes[0] if axes[0] @ mesh.centroid >= 0 else -axes[0]
    along = mesh.vertices @ axis
    fraction = (points_link @ axis - along.min()) / np.ptp(along)
    return (fraction >= start) & (fraction <= end)


def outer_mask(mesh: trimesh.Trimesh, points_link: np.ndarray, normals_link: np.ndarray) -> np.ndarray:
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
