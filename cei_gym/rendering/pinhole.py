"""Pinhole cameras: made from a viewpoint or from a MuJoCo camera, and depth turned back into points.

Pixel (0, 0) is the upper left one and integer coordinates are pixel centres, as in OpenCV, so the middle of
an image is ((W - 1) / 2, (H - 1) / 2).
"""

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError, unknown


def intrinsics(width: int, height: int, fovy_deg: float) -> Array:
    """(3, 3) K in pixels for square pixels and a vertical field of view in degrees."""
    if not (width > 0 and height > 0 and 0 < fovy_deg < 180):
        raise CEIError(f"a camera needs pixels and 0 < fovy < 180, not {width}x{height} and {fovy_deg}.")
    focal = height / 2 / np.tan(np.deg2rad(fovy_deg) / 2)
    return np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])


def look_at(
    name: str,
    eye: ArrayLike,
    target: ArrayLike,
    width: int,
    height: int,
    fovy_deg: float,
    up: ArrayLike = (0.0, 0.0, 1.0),
) -> Camera:
    """A camera at `eye` that looks at `target`: (3,) world points, metres; `up` (3,) is up in the image.

    Raises:
        CEIError: the line of sight has no length or is parallel to `up`.
    """
    forward = np.asarray(target, dtype=np.float64) - np.asarray(eye, dtype=np.float64)
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    if np.linalg.norm(right) < 1e-9:
        raise CEIError(f"camera {name!r} looks along its own up direction; give another `up`, or another target.")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T_world_camera[:3, 3] = eye
    return Camera(name, width, height, intrinsics(width, height, fovy_deg), T_world_camera)


def camera_from_mujoco(
    model: mujoco.MjModel, data: mujoco.MjData, camera: int | str, width: int, height: int
) -> Camera:
    """The model's camera where it is now (make one that moves with a body again when the body moves).

    Raises:
        CEIError: no such camera, or it is given by a sensor size instead of a field of view.
    """
    names = [model.camera(i).name for i in range(model.ncam)]
    if (camera not in names) if isinstance(camera, str) else not 0 <= camera < model.ncam:
        raise unknown("camera", camera, names)
    index = model.camera(camera).id
    if model.cam_sensorsize[index].any():
        raise CEIError(f"camera {names[index]!r} is given by a sensor size; only a fovy is understood.")
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = data.cam_xmat[index].reshape(3, 3) * (1.0, -1.0, -1.0)  # OpenGL to OpenCV axes
    T_world_camera[:3, 3] = data.cam_xpos[index]
    K = intrinsics(width, height, float(model.cam_fovy[index]))
    return Camera(names[index] or f"camera{index}", width, height, K, T_world_camera)


def camera_points(depth_m: Array, camera: Camera) -> Array:
    """(H, W, 3) points in the camera's frame in metres, the origin where depth is 0."""
    v, u = np.indices(depth_m.shape)
    K = camera.K
    return np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1) * depth_m[..., None]


def unproject(depth_m: Array, camera: Camera) -> Array:
    """Points seen in a depth image.

    Args:
        depth_m: (H, W) depth along the optical axis, metres; 0 or not finite means unknown.
        camera: the camera that took it.

    Returns:
        (N, 3) float64 points in the world, metres, one for each known pixel, row by row.

    Raises:
        CEIError: the image is not of the camera's size.
    """
    if depth_m.shape != (camera.height, camera.width):
        raise CEIError(
            f"camera {camera.name!r} takes images of {(camera.height, camera.width)}, not of {depth_m.shape}."
        )
    K, T = camera.K, camera.T_world_camera
    points_world = np.empty((depth_m.size, 3))
    count = _unproject(depth_m, K[0, 0], K[1, 1], K[0, 2], K[1, 2], T, points_world)
    return points_world[:count]


def resized(K: Array, factor: float) -> Array:
    """(3, 3) K of the same view in a picture `factor` times as large."""
    scaled = K.copy()
    scaled[:2, 2] = (scaled[:2, 2] + 0.5) * factor - 0.5  # integer coordinates are pixels' centres
    scaled[0, :2] *= factor
    scaled[1, 1] *= factor
    return scaled


def image_points(points_world: Array, camera: Camera) -> tuple[Array, Array]:
    """(N, 2) column and row, not rounded, of (N, 3) points in the world, and (N,) depth along the optical axis, m; behind the camera they mean nothing."""
    points_camera = (points_world - camera.T_world_camera[:3, 3]) @ camera.T_world_camera[:3, :3]
    depth_m = points_camera[:, 2]
    return points_camera[:, :2] / depth_m[:, None] * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2], depth_m


def project(points_world: Array, camera: Camera) -> tuple[Array, Array]:
    """Where points appear in a camera's image: the inverse of `unproject`, to a whole pixel.

    Args:
        points_world: (N, 3) metres.
        camera: the camera.

    Returns:
        (N, 2) int64 row and column of the nearest pixel, -1 for points beside the image or behind the camera; (N,) depth
        along the optical axis, metres.
    """
    points_camera = (points_world - camera.T_world_camera[:3, 3]) @ camera.T_world_camera[:3, :3]
    depth_m, K = points_camera[:, 2], camera.K
    pixel = np.full((len(points_world), 2), -1)
    ahead = np.flatnonzero(depth_m > 0)
    x, y = (points_camera[ahead, :2] / depth_m[ahead, None]).T
    row, column = np.rint(y * K[1, 1] + K[1, 2]), np.rint(x * K[0, 0] + K[0, 2])
    inside = (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
    pixel[ahead[inside]] = np.stack([row, column], axis=1)[inside]
    return pixel, depth_m


@njit(cache=True, nogil=True)
def _unproject(depth_m, fx, fy, cx, cy, T, points_world):
    count = 0
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            z = np.float64(depth_m[v, u])
            if not (np.isfinite(z) and z > 0.0):
                continue
            x, y = (u - cx) / fx * z, (v - cy) / fy * z
            for axis in range(3):
                points_world[count, axis] = x * T[axis, 0] + y * T[axis, 1] + z * T[axis, 2] + T[axis, 3]
            count += 1
    return count
