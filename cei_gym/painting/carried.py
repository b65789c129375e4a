"""What the source carries, cut out of the picture where it still lies, and drawn where the hand has it.

A camera never sees the half of a held object that the source's fingers hide, and they are what is taken out of the picture. Before fingers close it
lies there whole.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self, cast

import numpy as np
from scipy import ndimage

from cei_gym.alignment.contact.correction import Holds
from cei_gym.alignment.problem import Motion
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.painting.behind import Change, shown
from cei_gym.rendering import image_points, project

_CARRIED_M = 0.02  # by less nothing is carried
_LIES_M = 0.003  # what has moved by less lies where it lay
HAND_M = 0.06
"""Around the grip, what a hand may hold; nothing there shows what is behind."""
_REACH_M = 0.12  # around the grip, where something may have changed
_CHANGED = 24  # of 255
LEAST_PIXELS = 12
"""Fewer are no object."""


@dataclass(frozen=True)
class Carry:
    """A stretch in which the source carries something.

    Attributes:
        taken: the last frame in which it lies where it lay.
        placed: the first in which it is where it stays; the number of frames where it is held to the end.
        T_world_hand: (T, 4, 4) poses of the hand, of all frames.
        middle_world: (T, 3) where it is held, m.
    """

    taken: int
    placed: int
    T_world_hand: Array
    middle_world: Array

    def moved(self, frame: int) -> Array:
        """(4, 4) how what is carried has moved by a frame, in the world."""
        last = min(self.placed, len(self.T_world_hand) - 1)
        return self.T_world_hand[min(frame, last)] @ np.linalg.inv(self.T_world_hand[self.taken])


def carries(motion: Motion, T_world_base: Array) -> list[Carry]:
    """The holds of a source in which it carries something by 2 cm.

    Args:
        motion: of its pads, with its grip (`Transfer.motion`).
        T_world_base: (4, 4) pose of the base in whose frame that is: the target's.
    """
    found: list[Carry] = []
    grip, R, t = motion.grip, T_world_base[:3, :3], T_world_base[:3, 3]
    if grip is None:
        return found
    middle_world = motion.points_base.mean(axis=1) @ R.T + t
    T_world_hand = np.tile(np.eye(4), (len(middle_world), 1, 1))
    T_world_hand[:, :3, :3], T_world_hand[:, :3, 3] = R @ grip.rotation, grip.position @ R.T + t
    holds = Holds.of(grip, motion.dt_s or 0.0)
    for begin, end in zip(holds.first.tolist(), holds.last.tolist(), strict=True):
        path = middle_world[begin : end + 1]
        far = np.linalg.norm(path - path[0], axis=1)
        if far.max() < _CARRIED_M:
            continue
        taken = begin + max(0, int(np.argmax(far > _LIES_M)) - 1)
        away = np.flatnonzero(np.linalg.norm(path - path[-1], axis=1) > _LIES_M)
        placed = begin + int(away.max(initial=-1)) + 1
        held_to_the_end = end == len(middle_world) - 1
        found.append(Carry(taken, len(middle_world) if held_to_the_end else placed, T_world_hand, middle_world))
    return found


@dataclass(frozen=True)
class Flat:
    """An object as it looked where it lay: a plane that faces the camera, and goes where the object goes.

    Attributes:
        picture: (H, W, 3) uint8.
        alpha: (H, W) float32 in [0, 1], where it is the object.
        bulge_m: (H, W) float32, by how much its surface is nearer to the camera than its middle: taken for as deep as it is wide.
        points_world: (3, 3) of the plane, where the object lay, m.
    """

    picture: Array
    alpha: Array
    bulge_m: Array
    points_world: Array

    @classmethod
    def of(cls, picture: Array, where: Array, middle_world: Array, camera: Camera) -> Self:
        """What is at some pixels, (H, W) bool, of a picture, around a point of the world."""
        bulge_m, plane = _bulge(where, middle_world, camera), _plane(middle_world, camera)
        return cls(_spread(picture, where), where.astype(np.float32), bulge_m, plane)

    def moved(self, by: Array, camera: Camera) -> "Layer":
        """It after a motion (4, 4) in the world; three points of the plane make an affine map."""
        import cv2

        now = self.points_world @ by[:3, :3].T + by[:3, 3]
        affine = cv2.getAffineTransform(
            *(image_points(points, camera)[0].astype(np.float32) for points in (self.points_world, now))
        )
        size = camera.width, camera.height
        picture, alpha, bulge_m = (
            cv2.warpAffine(image, affine, size, flags=cv2.INTER_LINEAR)
            for image in (self.picture, self.alpha, self.bulge_m)
        )
        middle_m = (now[0] - camera.T_world_camera[:3, 3]) @ camera.T_world_camera[:3, 2]
        return Layer(picture, alpha, np.where(alpha > 0.5, middle_m - bulge_m, np.inf))


@dataclass(frozen=True)
class CutOut:
    """A carried object, cut out of the frame in which it was taken."""

    carry: Carry
    flat: Flat

    def is_drawn(self, frame: int, never: Array) -> bool:
        """Whether it is on its way in a frame, or where it stays, but (H, W) `never` seen there."""
        if frame <= self.carry.taken:
            return False
        return frame < self.carry.placed or bool((never & (self.flat.alpha > 0)).any())

    def at(self, frame: int, camera: Camera) -> "Layer":
        """It as the hand has it in a frame."""
        return self.flat.moved(self.carry.moved(frame), camera)


@dataclass(frozen=True)
class Layer:
    """A cut-out in a frame.

    Attributes:
        picture: (H, W, 3) uint8.
        alpha: (H, W) float32 in [0, 1], where it is.
        depth_m: (H, W) of its surface, m, inf where it is not.
    """

    picture: Array
    alpha: Array
    depth_m: Array

    def hard(self) -> "Layer":
        """The same with no pixel half of it."""
        return replace(self, alpha=(self.alpha > 0.5).astype(np.float32))


def cut_out(
    pictures: Array, covered: Sequence[Array], carry: Carry, camera: Camera
) -> tuple[CutOut | None, list[Change]]:
    """What is carried, and what its being taken and placed changes.

    Args:
        pictures: (T, H, W, 3) uint8.
        covered: of each frame, (K,) the robot's pixels.
        carry: when.
        camera: that took them.

    Returns:
        None where it cannot be told from what is behind it: never seen whole, or of its colour.
    """
    T = len(pictures)
    covered = list(covered)
    for t in range(carry.taken + 1, min(carry.placed, T)):  # near the hand is what it carries
        covered[t] = np.union1d(covered[t], np.flatnonzero(near_hand(carry.middle_world[t], camera)))
    taken = _changed(pictures, covered, carry.taken, carry.middle_world[carry.taken], camera)
    if taken is None:
        return None, []
    before, change = taken
    changes = [Change(carry.taken + 1, np.flatnonzero(change))]
    if carry.placed < T:
        placed = _changed(pictures, covered, carry.placed - 1, carry.middle_world[carry.placed], camera)
        if placed is not None:
            changes.append(Change(carry.placed, np.flatnonzero(placed[1])))
    cut = CutOut(carry, Flat.of(before, change, carry.middle_world[carry.taken], camera))
    return cut, changes


def _changed(
    pictures: Array, covered: Sequence[Array], frame: int, point_world: Array, camera: Camera
) -> tuple[Array, Array] | None:
    """How it looked before, and where near a point what is seen differs after a frame; None where that is nowhere, or nobody saw it."""
    before, known = shown(pictures, covered, range(frame, -1, -1))
    after, also = shown(pictures, covered, range(frame + 1, len(pictures)))
    near = _disc(point_world, _REACH_M, camera)
    differs = np.abs(before.astype(np.int16) - after).max(axis=-1) > _CHANGED
    changed = ndimage.binary_closing(differs & known & also & near, iterations=2)
    changed = ndimage.binary_fill_holes(changed & near)
    parts, count = cast("tuple[Array, int]", ndimage.label(changed))
    if not count:
        return None
    sizes = ndimage.sum_labels(changed, parts, np.arange(1, count + 1))
    part = parts == 1 + int(np.argmax(sizes))
    return (before, part) if sizes.max() >= LEAST_PIXELS else None


def near_hand(middle_world: Array, camera: Camera) -> Array:
    """(H, W) bool, the pixels in which there may be what a hand holds there."""
    return _disc(middle_world, HAND_M, camera)


def _disc(point_world: Array, radius_m: float, camera: Camera) -> Array:
    """(H, W) bool, the pixels within a distance of a point's."""
    ((row, column),), (depth_m,) = project(point_world[None], camera)
    if row < 0:
        return np.zeros((camera.height, camera.width), bool)
    v, u = np.ogrid[: camera.height, : camera.width]
    return (v - row) ** 2 + (u - column) ** 2 <= (camera.K[0, 0] * radius_m / depth_m) ** 2


def _bulge(where: Array, middle_world: Array, camera: Camera) -> Array:
    """See `CutOut.bulge_m`: a ball of the same area."""
    depth_m = (middle_world - camera.T_world_camera[:3, 3]) @ camera.T_world_camera[:3, 2]
    pixel_m = depth_m / camera.K[0, 0]
    v, u = np.nonzero(where)
    square_m2 = ((np.indices(where.shape) - np.array([v.mean(), u.mean()])[:, None, None]) ** 2).sum(
        axis=0
    ) * pixel_m**2
    return np.sqrt(np.maximum(len(v) * pixel_m**2 / np.pi - square_m2, 0.0)).astype(np.float32)


def _plane(point_world: Array, camera: Camera) -> Array:
    """(3, 3) a point, and those beside and below it as the camera has it, m."""
    right, down = camera.T_world_camera[:3, 0], camera.T_world_camera[:3, 1]
    return point_world + 0.05 * np.stack([0 * right, right, down])


def _spread(picture: Array, where: Array) -> Array:
    """The picture with what is nearest inside put outside, so that no edge takes in what was behind."""
    rows, columns = cast("Array", ndimage.distance_transform_edt(~where, return_distances=False, return_indices=True))
    return picture[rows, columns]
