"""Where a camera is, and how long its focal length, from what it saw of a robot whose joints are known: no board, no depth, no network.

A candidate predicts each picture: what is behind the robot, which the other pictures show, with the robot in it, in the light that fits best. Both are blurred
by a pixel, or the valley around the truth would be narrower than a step. Levenberg-Marquardt with a robust loss (Geman and McClure), coarse to
fine, from the best of a grid of directions; then the same with either half of the pictures, whose difference is the uncertainty.
"""

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym import extras
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.painting.behind import Plate
from cei_gym.painting.calibrated import Agreement, agreement
from cei_gym.painting.clicks import CLICK_PX, Clicks
from cei_gym.painting.composite import grown
from cei_gym.painting.light import Light
from cei_gym.painting.view import Drawn, RobotView
from cei_gym.rendering import image_points, resized, unproject

WIDTHS_PX = (80, 160, 320)
"""Widths of pictures at each level."""

_GRID_DEG, _GRID = 6.0, 9  # directions that are tried: up to so far from the guess, so many each way
_SEEDS, _APART_DEG = 3, 1.6  # of these the best, so far apart
_ROUNDS = (15, 8, 5)  # of each level
_MARGIN_PX, _BLUR_PX, _STEP_PX = 2.0, 1.2, 0.4  # of a level's pixels
_INLIER = 0.1  # of [0, 1]
_BELIEF = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.08])  # rad, m, and of the focal length's logarithm
_STILL_PX = 0.02
_THREADS = 2
_MOST_APART_PX, _LEAST_EXPLAINED = 2.0, 0.85


@dataclass(frozen=True)
class CameraFit:
    """A camera that was found.

    Attributes:
        camera: where it is.
        apart_px: mean distance, on the robot, between what the two halves of the pictures say.
        apart_most_px: the largest.
        moved_px: mean distance, on the robot, from the guess.
        agreement: how far pictures bear it out.
    """

    camera: Camera
    apart_px: float
    apart_most_px: float
    moved_px: float
    agreement: Agreement


def fit_camera(
    robot: Embodiment,
    T_world_base: Array,
    guess: Camera,
    pictures: Array,
    qpos: Array,
    advance: Callable[[float], None] = lambda _: None,
    clicks: Clicks | None = None,
) -> CameraFit:
    """Find a camera that stands still.

    Args:
        robot: what is seen.
        T_world_base: (4, 4) pose of its base.
        guess: the camera, roughly: by some centimetres, degrees, and per cent of the focal length.
        pictures: (N, H, W, 3) uint8, at least 8, in which the robot is at different places.
        qpos: (N, n) its joints in them, rad or m.
        advance: called with the share of the work that is done.
        clicks: that the camera keeps to; the guess then is what they say (`Clicks.camera`), and no other directions are tried.

    Raises:
        CEIError: nothing is found that the pictures bear out.
    """
    extras.require_module("finding a camera", "cv2")
    if len(pictures) < 8:
        raise CEIError(f"a camera is found by 8 pictures or more, not {len(pictures)}.")
    whole = _Fit(robot, T_world_base, guess, pictures, qpos, clicks)
    if not any((drawn.geom_id >= 0).any() for drawn in whole.drawn(np.zeros(7), WIDTHS_PX[0])):
        raise CEIError(f"{robot.name} is not in the view of camera {guess.name!r} by the guess; give a better one.")
    seeds = [np.zeros(7)] if clicks else whole.seeds(lambda done: advance(0.2 * done))
    with ThreadPoolExecutor(_THREADS) as threads:
        coarse = sorted(threads.map(lambda seed: whole.descend(seed, 0), seeds), key=lambda found: found[1])
    advance(0.5)
    halves = [
        _Fit(
            robot, T_world_base, guess, pictures[half::2], qpos[half::2], None if clicks is None else clicks.half(half)
        )
        for half in (0, 1)
    ]
    # From different starts, where there are such that come to the same.
    starts = [coarse[min(i, len(coarse) - 1)][0] for i in (0, 1)]
    starts = [start if whole.apart_px(start, coarse[0][0])[0] < _GRID_DEG else coarse[0][0] for start in starts]
    with ThreadPoolExecutor(_THREADS) as threads:
        jobs = zip((whole, *halves), (coarse[0][0], *starts), strict=True)
        found, *ends = threads.map(lambda job: job[0].refined(job[1]), jobs)
    advance(1.0)
    apart, most = whole.apart_px(*ends)
    camera = whole.camera(found)
    view = RobotView(robot, T_world_base, camera)
    covered = [np.flatnonzero(grown(view.silhouette(q), _MARGIN_PX)) for q in qpos]
    agreed = agreement(pictures, covered, Plate.median(pictures, covered))
    if not apart <= _MOST_APART_PX:
        raise CEIError(
            f"no camera is found: by one half of the pictures {guess.name!r} is {apart:.1f} pixels from where it is by the other (at most {_MOST_APART_PX:g}); give a "
            "better guess, or more pictures in which the robot is elsewhere."
        )
    if agreed.explained < _LEAST_EXPLAINED:
        raise CEIError(
            f"no camera is found: of what moves in pictures of {guess.name!r} only {100 * agreed.explained:.0f} % would be where {robot.name} is; give a better guess, "
            "or see whether joints and base are right."
        )
    return CameraFit(camera, apart, most, whole.apart_px(found, np.zeros(7))[0], agreed)


class _Fit:
    """Pictures, and how well a candidate explains them.

    A candidate is (7,): how the guess is turned (rotation vector, rad) and moved (m), in its own frame, and the logarithm of the focal length's ratio.
    """

    def __init__(
        self,
        robot: Embodiment,
        T_world_base: Array,
        guess: Camera,
        pictures: Array,
        qpos: Array,
        clicks: Clicks | None = None,
    ) -> None:
        self._clicks = clicks
        self._guess, self._pictures, self._qpos = guess, pictures, qpos
        self._view = RobotView(robot, T_world_base, guess)
        self._small: dict[int, list[Array]] = {}
        self._far_m = float(np.linalg.norm(T_world_base[:3, 3] - guess.T_world_camera[:3, 3]))

    def camera(self, candidate: Array, width: int | None = None) -> Camera:
        """The camera that a candidate says, at the pictures' width or another."""
        guess = self._guess
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec(candidate[:3]).as_matrix(), candidate[3:6]
        K = guess.K.copy()
        K[[0, 1], [0, 1]] *= np.exp(candidate[6])
        scale = 1.0 if width is None else min(1.0, width / guess.width)
        K = resized(K, scale)
        size = {"width": round(guess.width * scale), "height": round(guess.height * scale)}
        return replace(guess, K=K, T_world_camera=guess.T_world_camera @ moved, **size)

    def drawn(self, candidate: Array, width: int, finer: int = 2) -> list[Drawn]:
        """The robot in each picture."""
        camera = self.camera(candidate, width)
        return [self._view.draw(q, finer, camera) for q in self._qpos]

    def seeds(self, advance: Callable[[float], None]) -> list[Array]:
        """Candidates in some directions, best first."""
        found: list[tuple[float, Array]] = []
        for i, turn in enumerate(itertools.product(np.radians(np.linspace(-_GRID_DEG, _GRID_DEG, _GRID)), repeat=2)):
            candidate = np.array([*turn, 0, 0, 0, 0, 0])
            found.append((_loss(_Level(self, candidate, WIDTHS_PX[0]).residual(candidate)), candidate))
            advance((i + 1) / _GRID**2)
        seeds: list[Array] = []
        for _, candidate in sorted(found, key=lambda each: each[0]):
            if all(np.abs(candidate - seed).max() > np.radians(_APART_DEG) for seed in seeds):
                seeds.append(candidate)
        return seeds[:_SEEDS]

    def descend(self, candidate: Array, level: int) -> tuple[Array, float]:
        """The best candidate near one, by pictures of a level, and its loss."""
        width = WIDTHS_PX[level]
        focal_px = self.camera(candidate, width).K[0, 0]
        pixel = 1 / focal_px
        step = _STEP_PX * np.array([pixel] * 3 + [pixel * self._far_m] * 3 + [4 / min(width, self._guess.width)])
        damping, loss = 1e-2, np.inf
        for _ in range(_ROUNDS[level]):
            seen = _Level(self, candidate, width)  # as the candidate has it
            residual = seen.residual(candidate)
            loss = _loss(residual)
            known = self._known(candidate)
            before = loss + known @ known
            weight = 1 / (1 + (residual / _INLIER) ** 2) ** 2 / _INLIER**2
            slopes = [
                (seen.residual(candidate + h) - seen.residual(candidate - h)) / (2 * h.sum()) for h in np.diag(step)
            ]
            J = np.stack(slopes, axis=1)
            kept = np.stack(
                [(self._known(candidate + h) - self._known(candidate - h)) / (2 * h.sum()) for h in np.diag(step)],
                axis=1,
            )
            H, g = (J * weight[:, None]).T @ J + kept.T @ kept, J.T @ (weight * residual) + kept.T @ known
            for _ in range(8):
                change = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
                tried = candidate + change
                known = self._known(tried)
                if _loss(seen.residual(tried)) + known @ known < before:
                    break
                damping *= 5
            else:
                break
            candidate, damping = tried, max(damping / 5, 1e-6)
            if np.abs(change / step).max() * _STEP_PX < _STILL_PX:
                break
        return candidate, loss

    def _known(self, candidate: Array) -> Array:
        """(7 + 2 K,) what is known beside the pictures, less what a candidate says, each in units of its spread."""
        belief = candidate / _BELIEF
        if self._clicks is None:
            return belief
        off_px = self._clicks.off_px(self.camera(candidate))
        return np.concatenate([belief, off_px.ravel() / (CLICK_PX * self._guess.width / 640)])

    def refined(self, candidate: Array) -> Array:
        """The best candidate near one, by all levels but the first."""
        for level in range(1, len(WIDTHS_PX)):
            candidate, _ = self.descend(candidate, level)
        return candidate

    def apart_px(self, one: Array, other: Array) -> tuple[float, float]:
        """Mean and largest distance in pictures of what one candidate sees of the robot, and the other; inf where it sees none of it."""
        cameras = self.camera(one), self.camera(other)
        distances: list[Array] = []
        for drawn in self.drawn(one, WIDTHS_PX[0], 1):
            points_world = unproject(drawn.depth_m, drawn.camera)
            seen = [image_points(points_world, camera)[0] for camera in cameras]
            distances.append(np.linalg.norm(seen[0] - seen[1], axis=1))
        joined = np.concatenate(distances)
        return (float(joined.mean()), float(joined.max())) if len(joined) else (np.inf, np.inf)

    def small(self, width: int) -> list[Array]:
        """The pictures at a width, float32 in [0, 1]."""
        import cv2

        if width not in self._small:
            camera = self.camera(np.zeros(7), width)
            size = camera.width, camera.height
            small = [cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in self._pictures]
            self._small[width] = [picture.astype(np.float32) / 255 for picture in small]
        return self._small[width]

    @property
    def colours(self) -> Array:
        """(ngeom, 3) of the robot's geoms."""
        return self._view.colours


class _Level:
    """Pictures of one size, with what is behind the robot and the light, both as a candidate has them."""

    def __init__(self, fit: _Fit, candidate: Array, width: int) -> None:
        self._fit, self._width, self._pictures = fit, width, fit.small(width)
        stacked = np.stack(self._pictures)
        covered = np.zeros(stacked.shape[:3], bool)
        for mask, drawn in zip(covered, fit.drawn(candidate, width), strict=True):
            mask[drawn.part] = drawn.share > 0
            mask[:] = grown(mask, _MARGIN_PX)
        ordered = np.sort(np.where(covered[..., None], np.inf, stacked), axis=0)
        count = np.sum(~covered, axis=0)
        middle = np.maximum((count - 1) // 2, 0)[None, ..., None].repeat(3, axis=-1)
        self._known = count >= 2
        self._behind = np.where(self._known[..., None], np.take_along_axis(ordered, middle, axis=0)[0], 0)
        self._light = Light.read(fit.drawn(candidate, width, 1), self._pictures, fit.colours, from_edges_px=1)

    def residual(self, candidate: Array) -> Array:
        """What a candidate predicts less what was recorded, in [-1, 1], blurred."""
        import cv2

        parts: list[Array] = []
        for picture, drawn in zip(self._pictures, self._fit.drawn(candidate, self._width), strict=True):
            colours, share, _ = self._light.on(drawn, self._fit.colours)
            share = share.astype(np.float32)
            predicted, counts = self._behind.copy(), self._known.astype(np.float32)
            part = predicted[drawn.part]
            predicted[drawn.part] = part + share[..., None] * (colours.astype(np.float32) - part)
            counts[drawn.part] = np.maximum(counts[drawn.part], share)
            parts.append(cv2.GaussianBlur((predicted - picture) * counts[..., None], (0, 0), _BLUR_PX).ravel())
        return np.concatenate(parts)


def _loss(residual: Array) -> float:
    square = residual.astype(float) ** 2
    return float((square / (square + _INLIER**2)).sum())
