"""Which side of a finger is its palm side, and which part of its length is its pad."""

import numpy as np
import trimesh

from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.spec import Pad
from cei_gym.errors import CEIError
from cei_gym.kinematics.tree import KinematicTree


def palmar_directions(embodiment: Embodiment, tree: KinematicTree, pad: Pad, points_link: np.ndarray) -> np.ndarray:
    """Unit directions that points of a pad's link move in when the end-effector closes: the palmar side leads.

    Args:
        points_link: (N, 3) points in the pad's link frame, m.

    Returns:
        (N, 3) unit directions in the link's frame; the pad's own `palmar` direction where its YAML gives one.
    """
    if pad.palmar != "auto":
        direction = np.asarray(pad.palmar, float)
        if direction.shape != (3,) or not np.linalg.norm(direction) > 0:
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
    start, end = extent
    if not 0 <= start < end <= 1:
        raise CEIError(f"a pad's `extent` must be 0 <= start < end <= 1, not {extent}.")
    if (start, end) == (0, 1):
        return np.ones(len(points_link), bool)
    _, _, axes = np.linalg.svd(mesh.vertices - mesh.vertices.mean(0), full_matrices=False)
    axis = axes[0] if axes[0] @ mesh.centroid >= 0 else -axes[0]
    along = mesh.vertices @ axis
    fraction = (points_link @ axis - along.min()) / np.ptp(along)
    return (fraction >= start) & (fraction <= end)
