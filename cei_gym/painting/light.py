"""The light in recorded pictures, read from the robot whose surface is known, and thrown on another.

A pixel of a matt surface under distant lamps is its own colour times a smooth function of its normal: second-order spherical harmonics hold
98 % of it (Ramamoorthi and Hanrahan, 2001). How squarely the surface faces the camera is one more term, for lamps beside it and sheen, and the same
terms without the surface's own colour are what it mirrors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy import ndimage

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.painting.view import Drawn

TERMS = 10
_LIKE_NO_LIGHT = np.array([0.35, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.45])  # lamps above and beside the camera
_ROUNDS = 8
_STIFF = 1e-3, 1e-2  # of what is believed before: of terms with the surface's own colour, and of those without
_LEAST_PIXELS, _MOST_PIXELS = 200, 3000  # that light is read from
_INLIER = 0.05


@dataclass(frozen=True)
class Light:
    """A light.

    Attributes:
        weights: (2, 10, 3) of each term, with the surface's own colour and without, for red, green and blue.
        off: median of what it misses recorded pixels by, in [0, 1]; nan where there was nothing to read it from.
    """

    weights: Array
    off: float

    @classmethod
    def assumed(cls) -> Self:
        """Where nothing shows one: lamps above and beside the camera."""
        weights = np.zeros((2, TERMS, 3))
        weights[0] = _LIKE_NO_LIGHT[:, None]
        return cls(weights, float("nan"))

    @classmethod
    def fit(cls, colours: Array, terms: Array, pixels: Array) -> Self:
        """The light in which surfaces look as they do; what does not fit (what is in front of the robot, stickers) counts little.

        Args:
            colours: (M, 3) of the surfaces themselves, in [0, 1].
            terms: (M, 10) as of `surface_terms`.
            pixels: (M, 3) as recorded, in [0, 1].
        """
        believed = cls.assumed()
        if len(pixels) < _LEAST_PIXELS:
            return believed
        weights, left = np.empty((2, TERMS, 3)), np.empty(pixels.shape)
        stiff = len(pixels) * np.repeat(_STIFF, TERMS)
        for channel in range(3):
            rows = np.hstack([colours[:, channel, None] * terms, terms])
            before = believed.weights[:, :, channel].ravel()
            found, inlier = before, np.ones(len(rows))
            for _ in range(_ROUNDS):
                weighted = rows * inlier[:, None]
                normal = weighted.T @ rows + np.diag(stiff)
                found = np.linalg.solve(normal, weighted.T @ pixels[:, channel] + stiff * before)
                residual = pixels[:, channel] - rows @ found
                inlier = 1 / (1 + (residual / _INLIER) ** 2) ** 2
            weights[:, :, channel], left[:, channel] = found.reshape(2, TERMS), residual
        return cls(weights, float(np.median(np.abs(left))))

    @classmethod
    def read(cls, drawn: Sequence[Drawn], pictures: Sequence[Array], colours: Array, from_edges_px: int) -> Self:
        """The light in some pictures, by a robot in them.

        Args:
            drawn: the robot in each, as finely as they are.
            pictures: (H, W, 3) each, in [0, 1].
            colours: (ngeom, 3) of its geoms, in [0, 1].
            from_edges_px: so far from edges are the pixels that are looked at.
        """
        found: list[tuple[Array, Array, Array]] = []
        for each, picture in zip(drawn, pictures, strict=True):
            surface, known = surface_terms(each)
            at = np.flatnonzero(ndimage.binary_erosion(known, iterations=from_edges_px))
            at = at[:: max(1, len(at) * len(drawn) // _MOST_PIXELS)]
            own = colours[each.geom_id.ravel()[at]]
            found.append((own, surface.reshape(-1, TERMS)[at], picture[each.part].reshape(-1, 3)[at]))
        own, terms, pixels = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return cls.fit(own, terms, pixels)

    def on(self, drawn: Drawn, colours: Array) -> tuple[Array, Array, Array]:
        """A drawn robot in this light.

        Args:
            drawn: what is drawn.
            colours: (ngeom, 3) of its geoms, in [0, 1].

        Returns:
            (h, w, 3) float colours in [0, 1] of the picture's pixels, (h, w) the share of each that is the robot, and (h, w) its depth there, m.
        """
        camera, finer = drawn.camera, drawn.finer
        K, R = camera.K, np.ascontiguousarray(camera.T_world_camera[:3, :3])
        return _shine(drawn.depth_m, drawn.geom_id, K[0, 0], K[1, 1], K[0, 2], K[1, 2], R, colours, self.weights, finer)


def surface_terms(drawn: Drawn) -> tuple[Array, Array]:
    """What light is fitted on.

    Returns:
        (h, w, 10) terms of every pixel's surface, and (h, w) bool, where it is known: not at edges.
    """
    K, R = drawn.camera.K, np.ascontiguousarray(drawn.camera.T_world_camera[:3, :3])
    return _terms(drawn.depth_m, drawn.geom_id, K[0, 0], K[1, 1], K[0, 2], K[1, 2], R)


@njit(cache=True, nogil=True)
def _step(depth_m, geom_id, y, x, dy, dx, fx, fy, cx, cy, out):
    """The surface's tangent along an axis, from the neighbour on the same geom whose depth differs least; whether there is one."""
    height, width = depth_m.shape
    best, sign = np.inf, 0
    for side in (-1, 1):
        v, u = y + side * dy, x + side * dx
        if 0 <= v < height and 0 <= u < width and geom_id[v, u] == geom_id[y, x]:
            change = abs(depth_m[v, u] - depth_m[y, x])
            if change < best:
                best, sign = change, side
    if sign == 0:
        return False
    z0, z1 = depth_m[y, x], depth_m[y + sign * dy, x + sign * dx]
    out[0] = sign * ((x + sign * dx - cx) * z1 - (x - cx) * z0) / fx
    out[1] = sign * ((y + sign * dy - cy) * z1 - (y - cy) * z0) / fy
    out[2] = sign * (z1 - z0)
    return True


@njit(cache=True, nogil=True)
def _term(depth_m, geom_id, y, x, fx, fy, cx, cy, R, along, down, out):
    """Fill a pixel's ten terms; whether its normal is known. One that is not faces the camera."""
    ray_x, ray_y = (x - cx) / fx, (y - cy) / fy
    length = np.sqrt(ray_x * ray_x + ray_y * ray_y + 1.0)
    nx, ny, nz = -ray_x / length, -ray_y / length, -1.0 / length
    known = _step(depth_m, geom_id, y, x, 0, 1, fx, fy, cx, cy, along) and _step(
        depth_m, geom_id, y, x, 1, 0, fx, fy, cx, cy, down
    )
    facing = 1.0
    if known:
        a = along[1] * down[2] - along[2] * down[1]
        b = along[2] * down[0] - along[0] * down[2]
        c = along[0] * down[1] - along[1] * down[0]
        size = max(np.sqrt(a * a + b * b + c * c), 1e-15)
        facing = (a * nx + b * ny + c * nz) / size
        if facing < 0.0:
            size, facing = -size, -facing
        nx, ny, nz = a / size, b / size, c / size
    x_w = R[0, 0] * nx + R[0, 1] * ny + R[0, 2] * nz
    y_w = R[1, 0] * nx + R[1, 1] * ny + R[1, 2] * nz
    z_w = R[2, 0] * nx + R[2, 1] * ny + R[2, 2] * nz
    out[0], out[1], out[2], out[3] = 1.0, x_w, y_w, z_w
    out[4], out[5], out[6] = x_w * y_w, y_w * z_w, z_w * x_w
    out[7], out[8] = x_w * x_w - y_w * y_w, 3.0 * z_w * z_w - 1.0
    out[9] = facing
    return known


@njit(cache=True, nogil=True)
def _terms(depth_m, geom_id, fx, fy, cx, cy, R):
    height, width = depth_m.shape
    terms, known = np.zeros((height, width, TERMS)), np.zeros((height, width), np.bool_)
    along, down = np.empty(3), np.empty(3)
    for y in range(height):
        for x in range(width):
            if geom_id[y, x] >= 0:
                known[y, x] = _term(depth_m, geom_id, y, x, fx, fy, cx, cy, R, along, down, terms[y, x])
    return terms, known


@njit(cache=True, nogil=True)
def _shine(depth_m, geom_id, fx, fy, cx, cy, R, colours, weights, finer):
    height, width = depth_m.shape[0] // finer, depth_m.shape[1] // finer
    picture, share, nearest_m = np.zeros((height, width, 3)), np.zeros((height, width)), np.zeros((height, width))
    along, down, terms = np.empty(3), np.empty(3), np.empty(TERMS)
    for y in range(height):
        for x in range(width):
            count = 0
            for v in range(y * finer, (y + 1) * finer):
                for u in range(x * finer, (x + 1) * finer):
                    if geom_id[v, u] < 0:
                        continue
                    count += 1
                    nearest_m[y, x] += depth_m[v, u]
                    _term(depth_m, geom_id, v, u, fx, fy, cx, cy, R, along, down, terms)
                    for channel in range(3):
                        own = colours[geom_id[v, u], channel]
                        value = 0.0
                        for k in range(TERMS):
                            value += (own * weights[0, k, channel] + weights[1, k, channel]) * terms[k]
                        picture[y, x, channel] += min(max(value, 0.0), 1.0)
            if count:
                for channel in range(3):
                    picture[y, x, channel] /= count
                nearest_m[y, x] /= count
                share[y, x] = count / (finer * finer)
    return picture, share, nearest_m
