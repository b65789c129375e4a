"""What cameras saw of what is held: its points where it lay, and the space in which nothing is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera, Demonstration
from cei_gym.pointcloud.isolated import isolated
from cei_gym.rendering import unproject
from cei_gym.twin.hold import Hold

_VIEWS = 8  # frames before the hold that are looked at
_AWAY_M = 0.12  # from where it takes hold, the hand hides little
_ABOVE_M = 0.005
_LINK_M = 0.015  # points nearer than this to each other are of one thing
_SEED_M = 0.02
_STAYS_M, _STAYING = 0.008, 0.5
_VOXEL_M = 0.003
_BEHIND_M = 0.010  # a pixel that sees so far beyond a point sees that it is not there
_PLANE_M, _AROUND_M, _BIN_M = 0.015, 0.15, 0.001
_LEAST = 12


@dataclass(frozen=True)
class FreeSpace:
    """Where cameras saw that nothing is.

    Attributes:
        views: cameras, each with a (H, W) depth image, m, 0 where unknown.
    """

    views: tuple[tuple[Camera, Array], ...]

    def contains(self, points_world: Array) -> Array:
        """(N,) whether (N, 3) points are in it."""
        free = np.zeros(len(points_world), bool)
        for camera, depth_m in self.views:
            T = np.linalg.inv(camera.T_world_camera)
            p = points_world @ T[:3, :3].T + T[:3, 3]
            z = np.maximum(p[:, 2], 1e-6)
            uv = np.rint((p @ camera.K.T)[:, :2] / z[:, None]).astype(int)
            inside = (p[:, 2] > 0) & (uv >= 0).all(axis=1) & (uv < [camera.width, camera.height]).all(axis=1)
            seen = np.zeros(len(p))
            seen[inside] = depth_m[uv[inside, 1], uv[inside, 0]]
            free |= inside & (seen > p[:, 2] + _BEHIND_M)
        return free


@dataclass(frozen=True)
class Seen:
    """What was seen.

    Attributes:
        points_world: (N, 3) on what is held, where it lay, m.
        support_z_m: height of what it stands on, world.
        free: space in which nothing is.
    """

    points_world: Array
    support_z_m: float
    free: FreeSpace


def see(demonstration: Demonstration, scenes: Sequence[Array], hold: Hold) -> Seen | None:
    """Find what is held in what cameras saw before, when it lay still.

    Args:
        demonstration: of the source.
        scenes: for each frame (M, 3 or 6) points beside the source, world, m.
        hold: of the source.

    Returns:
        None where next to nothing was seen where it takes hold.
    """
    frames = _views(hold)
    support = _support(demonstration, frames, hold)
    points = np.concatenate([scenes[t][:, :3] for t in frames])
    points = points[points[:, 2] > support + _ABOVE_M]
    points = points[np.linalg.norm(points[:, :2] - hold.middle_world[hold.first, :2], axis=1) < 2 * _AROUND_M]
    points = points[~isolated(points, 2 * _VOXEL_M, max(1, len(frames) // 2))]
    points = _averaged(points)
    points = _connected(points, hold)
    points = _leaving(points, scenes, hold)
    if len(points) < _LEAST:
        return None
    return Seen(points, support, _free(demonstration, frames))


def _views(hold: Hold) -> Array:
    """Frames before the hold that show most: those in which the hand is away, else the farthest."""
    away = np.linalg.norm(hold.middle_world[: hold.first + 1] - hold.contacts_world.mean(axis=0), axis=1)
    clear = np.flatnonzero(away > _AWAY_M)
    if not len(clear):
        clear = np.sort(np.argsort(-away)[:_VIEWS])
    return clear[np.unique(np.linspace(0, len(clear) - 1, _VIEWS).astype(int))]


def _support(demonstration: Demonstration, frames: Array, hold: Hold) -> float:
    """Height of the support, where most of what a camera sees around the hold is, if that is near where it should be."""
    believed = demonstration.scene.support_z_m
    where, heights = hold.contacts_world.mean(axis=0), [np.zeros(0)]
    for camera in demonstration.scene.cameras:
        if camera.name in demonstration.depth_m:
            points = unproject(demonstration.depth_m[camera.name][frames[0]], camera)
            near = np.abs(points[:, :2] - where[:2]).max(axis=1) < _AROUND_M
            heights.append(points[near & (np.abs(points[:, 2] - believed) < _PLANE_M), 2])
    z = np.concatenate(heights)
    if len(z) < 10 * _LEAST:
        return believed
    count, edges = np.histogram(z, np.arange(believed - _PLANE_M, believed + _PLANE_M, _BIN_M))
    at = np.convolve(count, [1, 1, 1], "same").argmax()
    return float(np.median(z[np.abs(z - edges[at] - _BIN_M / 2) < 3 * _BIN_M]))


def _averaged(points: Array) -> Array:
    """One point for each cell: the mean of those in it."""
    if not len(points):
        return points
    _, cell = np.unique(np.floor(points / _VOXEL_M).astype(int), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell)
    return np.stack([np.bincount(cell, points[:, i]) / count for i in range(3)], axis=1)


def _connected(points: Array, hold: Hold) -> Array:
    """Points that hang together with some between the contacts."""
    if not len(points):
        return points
    one, two = hold.contacts_world
    share = np.clip((points - one) @ (two - one) / max(float((two - one) @ (two - one)), 1e-9), 0, 1)
    near = np.linalg.norm(points - one - share[:, None] * (two - one), axis=1) < _SEED_M
    pairs = KDTree(points).query_pairs(_LINK_M, output_type="ndarray")
    n = len(points)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    return points[np.isin(label, np.unique(label[near]))]


def _leaving(points: Array, scenes: Sequence[Array], hold: Hold) -> Array:
    """Points that are gone when what is held is farthest away; all where most seem to stay, as it then hides its own place."""
    late = scenes[int(hold.carried_m.argmax())][:, :3]
    if not len(late) or not len(points):
        return points
    stays = KDTree(late).query(points, distance_upper_bound=_STAYS_M)[0] < _STAYS_M
    return points if stays.mean() > _STAYING else points[~stays]


def _free(demonstration: Demonstration, frames: Array) -> FreeSpace:
    """By the nearest that each pixel saw in any of the frames: what it saw beyond is free in all of them."""
    views = []
    for camera in demonstration.scene.cameras:
        if camera.name in demonstration.depth_m:
            images = demonstration.depth_m[camera.name][frames]
            unknown = ~(np.isfinite(images) & (images > 0))
            nearest = np.where(unknown, np.inf, images).min(axis=0)
            views.append((camera, np.where(np.isfinite(nearest), nearest, 0.0)))
    return FreeSpace(tuple(views))
