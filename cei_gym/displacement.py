"""What spatial augmentation moves: the objects, all of them as one, and the recorded hand, which goes where they are."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np
from scipy.spatial import KDTree

from cei_gym.arrays import Array


class Region(Protocol):
    """Which points of T frames belong to objects."""

    def contains(self, points_world: Array, t: int) -> Array:
        """(N,) bool of the points (N, 3) recorded at frame t, m."""
        ...

    def at(self, frames: Array) -> Self:
        """The region with its frames at these indices."""
        ...


@dataclass(frozen=True)
class Boxes:
    """A region of boxes that may move.

    Attributes:
        T_world_box: (T, K, 4, 4) poses of their middles.
        half_m: (K, 3) half sizes, m.
    """

    T_world_box: Array
    half_m: Array

    def contains(self, points_world: Array, t: int) -> Array:
        """(N,) which points are in any of the boxes at frame t."""
        inside = np.zeros(len(points_world), bool)
        for T, half in zip(self.T_world_box[t], self.half_m, strict=True):
            inside |= (np.abs((points_world - T[:3, 3]) @ T[:3, :3]) <= half).all(axis=1)
        return inside

    def at(self, frames: Array) -> "Boxes":
        """The boxes with their frames at these indices."""
        return replace(self, T_world_box=self.T_world_box[frames])


@dataclass(frozen=True)
class Seen:
    """A region of what was seen on objects.

    Attributes:
        points_world: for each of T frames (M, 3), m.
        within_m: what is this near to one of them belongs to them.
    """

    points_world: Sequence[Array]
    within_m: float

    def contains(self, points_world: Array, t: int) -> Array:
        """(N,) which points are near to any that was seen at frame t."""
        seen = self.points_world[t]
        if not len(seen):
            return np.zeros(len(points_world), bool)
        return KDTree(seen).query(points_world, distance_upper_bound=self.within_m)[0] < np.inf

    def at(self, frames: Array) -> "Seen":
        """The region with its frames at these indices."""
        return replace(self, points_world=[self.points_world[t] for t in frames])


@dataclass(frozen=True)
class Displacement:
    """How a demonstration differs from what was recorded (`cei_gym.augmentation`).

    Attributes:
        T_world_objects: (4, 4) motion of the objects, the same at all frames.
        T_world_source: (T, 4, 4) motion of the whole source, with its base, from where it was recorded.
        objects: which of the points that are not the source's move with the objects; None for all.
    """

    T_world_objects: Array
    T_world_source: Array
    objects: Region | None = None

    def move(self, points_world: Array, t: int) -> Array:
        """Frame t's recorded points (N, 3 or 6), m, without the source's; those of objects moved."""
        T, moved = self.T_world_objects, points_world.copy()
        which = slice(None) if self.objects is None else self.objects.contains(points_world[:, :3], t)
        moved[which, :3] = moved[which, :3] @ T[:3, :3].T + T[:3, 3]
        return moved

    def at(self, frames: Array) -> "Displacement":
        """The displacement with its frames at these indices."""
        objects = None if self.objects is None else self.objects.at(frames)
        return replace(self, T_world_source=self.T_world_source[frames], objects=objects)
