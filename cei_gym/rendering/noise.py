"""What real depth cameras do to a depth image, and to what one believes of where they stand."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError, unknown


@dataclass(frozen=True)
class DepthNoise:
    """Noise of a depth camera; the defaults are none.

    Attributes:
        axial_m, axial_per_m, axial_from_m: a depth z has a standard deviation of
            axial_m + axial_per_m (z - axial_from_m)^2.
        lateral_rad: standard deviation of the direction in which a pixel really looks, along each axis.
        edge_m: where depth bends by more than this between a pixel and its two neighbours is an edge of an object.
        flying_share: share of pixels at edges with a depth anywhere between the two sides.
        edge_dropout_share: share of pixels at edges without a depth.
        dropout_share: the same of all others.
        grazing_deg: surfaces at which a pixel looks at a greater angle to their normal have no depth.
        tilt_deg, shift_m: how far each camera's believed pose is turned and shifted from its true one.
        seed: of the directions of tilt and shift, which stay while images' noise varies.

    Raises:
        CEIError: a number that cannot be.
    """

    axial_m: float = 0.0
    axial_per_m: float = 0.0
    axial_from_m: float = 0.0
    lateral_rad: float = 0.0
    edge_m: float = 0.02
    flying_share: float = 0.0
    edge_dropout_share: float = 0.0
    dropout_share: float = 0.0
    grazing_deg: float = 90.0
    tilt_deg: float = 0.0
    shift_m: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            most = 1.0 if field.name.endswith("_share") else np.finfo(float).max
            if not (isinstance(value, int | float) and 0 <= value <= most):
                at_most = " and at most 1" if most == 1 else ""
                raise CEIError(f"depth noise {field.name}={value!r} should be a number, at least 0{at_most}.")


# Axial and lateral noise: Nguyen, Izadi, Lovell, "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and
# Tracking", 3DIMPVT 2012 (lateral 0.8 pixels of 585 pixels' focal length). The rest are magnitudes as one meets them,
# tilt and shift those of a careful hand-eye calibration.
PRESETS = {
    "kinect": DepthNoise(
        axial_m=0.0012,
        axial_per_m=0.0019,
        axial_from_m=0.4,
        lateral_rad=0.8 / 585,
        flying_share=0.3,
        edge_dropout_share=0.3,
        dropout_share=0.01,
        grazing_deg=80.0,
        tilt_deg=0.2,
        shift_m=0.002,
    )
}
"""Noise of known sensors, by name."""


def as_noise(noise: str | Mapping[str, float] | None) -> DepthNoise | None:
    """Noise from a preset's name or from fields of `DepthNoise`; None stays None.

    Raises:
        CEIError: no such preset or field, or a value that cannot be.
    """
    if noise is None:
        return None
    if isinstance(noise, str):
        if noise not in PRESETS:
            raise unknown("depth noise", noise, PRESETS)
        return PRESETS[noise]
    names = [field.name for field in fields(DepthNoise)]
    for name in noise:
        if name not in names:
            raise unknown("field of depth noise", name, names)
    return DepthNoise(**noise)  # pyright: ignore[reportArgumentType]


def miscalibrated(camera: Camera, noise: DepthNoise) -> Camera:
    """A camera with its calibration's error: turned by `tilt_deg` about its centre, which is off by `shift_m`.

    The directions follow from the seed and the camera's name.
    """
    random = np.random.default_rng([int(noise.seed), *camera.name.encode()])
    axis, direction = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
    error = np.eye(4)
    error[:3, :3] = Rotation.from_rotvec(noise.tilt_deg * axis, degrees=True).as_matrix()
    error[:3, 3] = noise.shift_m * direction
    return replace(camera, T_world_camera=camera.T_world_camera @ error)


def add_noise(depth_m: Array, camera: Camera, noise: DepthNoise, random: np.random.Generator) -> Array:
    """A depth image as a real camera would have it.

    Args:
        depth_m: (H, W) depth along the optical axis, metres; 0 or not finite means unknown.
        camera: the camera that took it.
        noise: what to add; tilt and shift are no part of an image (see `believed`).
        random: drawn from the same number of times whatever is in the image.

    Returns:
        (H, W) float32, 0 where unknown.
    """
    normal = random.standard_normal((3, *depth_m.shape), dtype=np.float32)
    uniform = random.random((3, *depth_m.shape), dtype=np.float32)
    K = camera.K
    result = np.empty(depth_m.shape, dtype=np.float32)
    _add_noise(
        np.where(np.isfinite(depth_m), depth_m, 0).astype(np.float64),
        (K[0, 0], K[1, 1], K[0, 2], K[1, 2]),
        (noise.axial_m, noise.axial_per_m, noise.axial_from_m),
        noise.lateral_rad,
        noise.edge_m,
        (noise.flying_share, noise.edge_dropout_share, noise.dropout_share),
        np.cos(np.deg2rad(min(noise.grazing_deg, 90.0))),
        normal,
        uniform,
        result,
    )
    return result


@njit(cache=True, nogil=True)
def _add_noise(depth_m, intrinsics, axial, lateral_rad, edge_m, shares, least_cosine, normal, uniform, result):
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    flying, edge_dropout, dropout = shares
    for v in range(height):
        for u in range(width):
            # The nearest pixel to where this one looks.
            i = min(max(int(np.rint(v + normal[0, v, u] * lateral_rad * fy)), 0), height - 1)
            j = min(max(int(np.rint(u + normal[1, v, u] * lateral_rad * fx)), 0), width - 1)
            z = depth_m[i, j]
            result[v, u] = 0.0
            if not z > 0.0:
                continue
            above = depth_m[i - 1, j] if i > 0 else 0.0
            below = depth_m[i + 1, j] if i + 1 < height else 0.0
            left = depth_m[i, j - 1] if j > 0 else 0.0
            right = depth_m[i, j + 1] if j + 1 < width else 0.0
            if _cosine(z, above, below, left, right, (j - cx) / fx, (i - cy) / fy, fx, fy) < least_cosine:
                continue
            beyond = z  # the depth on the other side of an edge
            for one, other in ((above, below), (left, right)):
                if one > 0.0 and other > 0.0 and abs(one + other - 2.0 * z) > edge_m:
                    for depth in (one, other):
                        if abs(depth - z) > abs(beyond - z):
                            beyond = depth
            if uniform[0, v, u] < (dropout if beyond == z else edge_dropout):
                continue
            if uniform[1, v, u] < flying:
                z += uniform[2, v, u] * (beyond - z)
            z += normal[2, v, u] * (axial[0] + axial[1] * (z - axial[2]) ** 2)
            result[v, u] = max(z, 0.0)


@njit(cache=True, nogil=True)
def _cosine(z, above, below, left, right, x, y, fx, fy):
    """Cosine of the angle between a ray (x, y, 1) and the normal of the surface that it meets at depth z.

    1/z is affine in the image of a plane: its gradient is the normal. At an edge the flatter side counts.
    """
    w = 1.0 / z
    wx = _flatter(w, left, right) * fx
    wy = _flatter(w, above, below) * fy
    wz = w - x * wx - y * wy
    return w / np.sqrt((wx * wx + wy * wy + wz * wz) * (x * x + y * y + 1.0))


@njit(cache=True, nogil=True)
def _flatter(w, before, after):
    """The smaller step of inverse depth to either neighbour; 0 if neither is known."""
    step, found = 0.0, False
    if after > 0.0:
        step, found = 1.0 / after - w, True
    if before > 0.0 and (not found or abs(w - 1.0 / before) < abs(step)):
        step = w - 1.0 / before
    return step
