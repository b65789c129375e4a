"""Where a robot's outline should be in a picture, and where the picture has an edge near there."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from cei_gym.arrays import Array
from cei_gym.painting.view import Drawn

_EVERY_PX = 5.0  # of an outline one point is looked at
_STEP_PX = 0.5  # of the search
_SIDE_PX = 3.0  # what is compared on either side of an edge: grain and grooves are narrower
_CONTRAST = 0.04  # of [0, 1]: less is no edge


@dataclass(frozen=True)
class Outline:
    """Points on a robot's outline in one picture.

    Attributes:
        points_world: (M, 3) m.
        geom: (M,) whose they are, as in `RobotView.colours`.
        pixels: (M, 2) column and row.
        normals: (M, 2) unit, out of the robot.
    """

    points_world: Array
    geom: Array
    pixels: Array
    normals: Array

    @classmethod
    def of(cls, drawn: Drawn) -> Self:
        """The outline of a robot that is drawn as finely as the picture; where the picture ends is none."""
        import cv2

        inside = (drawn.geom_id >= 0).astype(np.float32)
        inner = cv2.erode(inside, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
        smooth = cv2.GaussianBlur(inside, (0, 0), 2.0, borderType=cv2.BORDER_REPLICATE)
        slope = np.stack([cv2.Sobel(smooth, cv2.CV_32F, *axis, ksize=3) for axis in ((1, 0), (0, 1))], axis=-1)
        rows, columns = np.nonzero((inside > 0) & (inner == 0) & (np.linalg.norm(slope, axis=-1) > 1e-3))
        chosen = np.random.default_rng(0).permutation(len(rows))[: int(len(rows) / _EVERY_PX)]
        rows, columns = rows[chosen], columns[chosen]
        normals = -slope[rows, columns] / np.linalg.norm(slope[rows, columns], axis=1, keepdims=True)
        K, T = drawn.camera.K, drawn.camera.T_world_camera
        # A pixel of the robot is half a pixel inside of its outline.
        pixels = np.stack([columns, rows], axis=1) + 0.5 * normals
        rays = np.column_stack([(pixels - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones(len(pixels))])
        points_world = rays * drawn.depth_m[rows, columns, None] @ T[:3, :3].T + T[:3, 3]
        return cls(points_world, drawn.geom_id[rows, columns], pixels + (drawn.column, drawn.row), normals)


def edges_px(picture: Array, outline: Outline, reach_px: float) -> Array:
    """How far along its normal from each point of an outline a picture has its edge.

    Args:
        picture: (H, W, 3) float32 in [0, 1].
        outline: (M) points.
        reach_px: so far is looked, both ways.

    Returns:
        (M,) pixels, positive out of the robot; nan where there is no edge.
    """
    import cv2

    if not len(outline.pixels):
        return np.empty(0)
    side = round(_SIDE_PX / _STEP_PX)
    at = np.arange(-round(reach_px / _STEP_PX) - side, round(reach_px / _STEP_PX) + side + 1) * _STEP_PX
    u, v = np.moveaxis(outline.pixels[:, None] + at[:, None] * outline.normals[:, None], -1, 0).astype(np.float32)
    profile = cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    total = np.concatenate([np.zeros_like(profile[:, :1]), profile.cumsum(axis=1)], axis=1)
    means = (total[:, side:] - total[:, :-side]) / side
    height, width = picture.shape[:2]
    step = np.linalg.norm(means[:, side + 1 :] - means[:, : -side - 1], axis=-1)
    at, u, v = at[side:-side], u[:, side:-side], v[:, side:-side]
    step[(u < side) | (u > width - 1 - side) | (v < side) | (v > height - 1 - side)] = 0
    peak = step[:, 1:-1] * (
        (step[:, 1:-1] >= step[:, :-2]) & (step[:, 1:-1] > step[:, 2:]) & (step[:, 1:-1] > _CONTRAST)
    )
    peak *= np.exp(-0.5 * (at[1:-1] / (0.5 * reach_px)) ** 2)  # of two the nearer, unless the other is much the clearer
    best = peak.argmax(axis=1)
    return np.where(peak[np.arange(len(best)), best] > 0, at[1:-1][best], np.nan)
