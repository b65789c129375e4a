"""One picture put together: what is behind the robot that goes, what is carried, the robot that comes."""

from collections.abc import Iterable, Sequence

import numpy as np

from cei_gym.arrays import Array
from cei_gym.painting.behind import Plate
from cei_gym.painting.carried import Layer
from cei_gym.painting.light import Light
from cei_gym.painting.view import Drawn, RobotView

_SCENE_M = 0.01  # by so much recorded depth is nearer than the robot, before it hides it
_INPAINT_PX = 3
_FINENESS = 1, 2  # pixels to draw for one of the picture's, in each direction: recorded edges are hard or smooth


def completed(scene: Array, never: Array, drawn: Drawn, plate: Plate | None) -> tuple[Array, int, int]:
    """A picture with what nothing of the episode shows.

    Args:
        scene: (H, W, 3) uint8; changed.
        never: (H, W) bool, what of it is unknown.
        drawn: the robot that is to come, which hides some of that.
        plate: what other episodes show.

    Returns:
        The picture, and of what the robot does not hide how many pixels are from other episodes, and how many inpainted.
    """
    left = never.copy()
    left[drawn.part] &= drawn.share < 1
    if not left.any():
        return scene, 0, 0
    import cv2

    pooled = 0
    if plate is not None:
        known = never & plate.known
        scene[known] = plate.picture[known]
        pooled = int((left & known).sum())
        never, left = never & ~known, left & ~known
    if left.any():
        scene = cv2.inpaint(scene, never.astype(np.uint8), _INPAINT_PX, cv2.INPAINT_TELEA)
    return scene, pooled, int(left.sum())


def with_layers(scene: Array, robot: Array, layers: Sequence[Layer], depth_m: Array | None) -> Array:
    """Draw what is carried where the source hid it, in place; (H, W) depth of what may be before a robot, m, inf where nothing is."""
    hidden = np.zeros(scene.shape[:2], bool)
    hidden.ravel()[robot] = True
    near_m = np.full(hidden.shape, np.inf)
    if depth_m is not None:
        near_m[(depth_m > 0) & ~hidden] = depth_m[(depth_m > 0) & ~hidden] + _SCENE_M
    for layer in layers:
        share = np.where(hidden, layer.alpha, 0)[..., None]
        scene[:] = np.rint(scene + share * (layer.picture.astype(np.float32) - scene))
        near_m = np.where(np.isfinite(near_m), near_m, layer.depth_m)
    return near_m


def with_robot(scene: Array, near_m: Array | None, drawn: Drawn, own: Array, light: Light) -> Array:
    """Draw a robot with geoms of its own colours, but where something is nearer, in place."""
    colours, share, depth_m = light.on(drawn, own)
    if near_m is not None:
        share = np.where(near_m[drawn.part] < depth_m, 0.0, share)
    part = scene[drawn.part]
    scene[drawn.part] = np.rint(part + share[..., None] * (255 * colours - part))
    return scene


def fineness(robot: RobotView, seen: Iterable[tuple[Array, Array, Array]], light: Light) -> int:
    """How finely to draw, so that a robot's edges are as hard or smooth as in pictures of it.

    Args:
        robot: that is in them.
        seen: (n,) joints, (H, W, 3) uint8 what is behind the robot, and (H, W, 3) uint8 the picture of each.
        light: in them.
    """
    off = dict.fromkeys(_FINENESS, 0.0)
    for qpos, behind, picture in seen:
        inside = robot.silhouette(qpos)
        edge = grown(inside, 1) & grown(~inside, 1)
        for finer in _FINENESS:
            again = with_robot(behind.copy(), None, robot.draw(qpos, finer), robot.colours, light)
            off[finer] += float(np.abs(again[edge].astype(float) - picture[edge]).sum())
    return min(off, key=off.__getitem__)


def grown(mask: Array, by_px: float) -> Array:
    """(H, W) bool, with what is within a distance."""
    import cv2

    if by_px <= 0:
        return mask
    size = 2 * int(np.ceil(by_px)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.dilate(mask.astype(np.uint8), kernel).astype(bool)
