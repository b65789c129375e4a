"""A camera from points of a robot that somebody clicked in its pictures: where the fit of its pictures begins, and what it keeps to."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError
from cei_gym.rendering import image_points

CLICK_PX = 3.0
"""By so much people miss, in pictures of 640 pixels."""

LEAST = 4
"""So many tell where a camera is."""

_FOCAL = 0.15  # what is believed of the focal length's logarithm
_WORST_PX = 12.0


@dataclass(frozen=True)
class Clicks:
    """Points of a robot, and where a camera's pictures show them.

    Attributes:
        points_world: (K, 3) m.
        pixels: (K, 2) column and row.
    """

    points_world: Array
    pixels: Array

    def half(self, which: int) -> "Clicks | None":
        """Every other one, from the first (0) or the second (1): halves that know nothing of each other; None where they are too few."""
        points, pixels = self.points_world[which::2], self.pixels[which::2]
        return Clicks(points, pixels) if len(self.pixels) >= 2 * LEAST else None

    def off_px(self, camera: Camera) -> Array:
        """(K, 2) columns and rows by which a camera misses them."""
        return image_points(self.points_world, camera)[0] - self.pixels

    def camera(self, guess: Camera) -> Camera:
        """The camera that sees the points where they were clicked; of the guess only the focal length is believed, roughly.

        Raises:
            CEIError: there are too few, they do not tell where it is, or it would miss one of them by far.
        """
        import cv2

        if len(self.pixels) < LEAST:
            raise CEIError(f"a camera is found by {LEAST} clicks or more, not {len(self.pixels)}.")
        middle = self.points_world.mean(axis=0)
        points, pixels = self.points_world - middle, np.ascontiguousarray(self.pixels, float)
        if np.linalg.matrix_rank(points, tol=0.02) < 2:
            raise CEIError("the points clicked lie on one line; click some beside it.")
        ends: list[tuple[float, Camera]] = []
        methods = [cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_EPNP]
        for method in methods:
            try:
                ok, turns, moves, _ = cv2.solvePnPGeneric(points, pixels, guess.K, np.zeros(5), flags=method)
            except cv2.error:
                continue
            ends += [self._polished(guess, turn, move, middle) for turn, move in zip(turns, moves, strict=True) if ok]
        ends = [end for end in ends if (image_points(self.points_world, end[1])[1] > 0).all()]
        if not ends:
            raise CEIError(
                "no camera sees the points clicked where they were clicked; see whether they are named rightly."
            )
        _, camera = min(ends, key=lambda end: end[0])
        off_px = np.linalg.norm(self.off_px(camera), axis=1)
        worst, most_px = int(off_px.argmax()), _WORST_PX * max(1.0, guess.width / 640)
        if off_px[worst] > most_px:
            raise CEIError(
                f"the clicks contradict each other: any camera misses one by {off_px[worst]:.0f} pixels (at most {most_px:.0f}), here number {worst + 1} at "
                f"({self.pixels[worst, 0]:.0f}, {self.pixels[worst, 1]:.0f}); see whether it is named rightly."
            )
        return camera

    def _polished(self, guess: Camera, turn: Array, move: Array, middle: Array) -> tuple[float, Camera]:
        """The cost of the nearest camera, and it, from a rotation vector and a translation of OpenCV's."""
        noise_px = CLICK_PX * guess.width / 640

        def camera(found: Array) -> Camera:
            R = Rotation.from_rotvec(found[:3]).as_matrix()
            T, K = np.eye(4), guess.K.copy()
            T[:3, :3], T[:3, 3] = R.T, middle - R.T @ found[3:6]
            K[[0, 1], [0, 1]] *= np.exp(found[6])
            return replace(guess, K=K, T_world_camera=T)

        def residual(found: Array) -> Array:
            return np.append(self.off_px(camera(found)).ravel() / noise_px, found[6] / _FOCAL)

        start = np.concatenate([np.ravel(turn), np.ravel(move), [0.0]])
        found = least_squares(residual, start, loss="soft_l1", x_scale="jac")
        return float(found.cost), camera(found.x)
