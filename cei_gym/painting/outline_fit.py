"""Where a camera is, and by how much its pictures trail the joints, from robots' outlines: what real pictures agree on with a description.

Real surfaces have covers, bands and sheen that no description has, but end where it says. Around each point of an outline the picture's edge is looked for along the
normal; camera, focal length and lag are moved so that edges are met (least squares, a robust loss), and it is drawn again, each time with a shorter reach.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cei_gym import extras
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.names import END_EFFECTOR_PREFIX
from cei_gym.errors import CEIError
from cei_gym.painting.behind import Plate
from cei_gym.painting.calibrated import agreement
from cei_gym.painting.camera_fit import CameraFit
from cei_gym.painting.clicks import CLICK_PX, Clicks
from cei_gym.painting.composite import grown
from cei_gym.painting.edges import Outline, edges_px
from cei_gym.painting.view import RobotView
from cei_gym.rendering import image_points

REACHES_PX = (16.0, 12.0, 8.0, 6.0, 5.0, 4.0)
"""So far edges are looked for, in pictures of 640 pixels."""

MET_PX = 2.0
"""An edge this near to its outline is met."""

_BELIEF = np.array(
    [0.05, 0.05, 0.05, 0.03, 0.03, 0.03, 0.03, 0.1]
)  # rad, m, of the focal length's logarithm, and s of lag
_STARTS = np.outer(
    [0, 1, -1], [0.01, -0.015, 0.005, 0.005, 0.005, -0.005, 0.01, 0.0]
)  # some twenty pixels around the guess
_LAGS_S, _FAST = np.arange(-2, 7) * 0.05, 8  # that are tried, in so many pictures
_MOST_APART_PX, _LEAST_MET = 2.0, 0.4
_COUNT = 300  # what all edges together count, as if so many knew nothing of each other
_MOMENT_S = 0.02
_MOVES_M = 0.01  # by more a link is elsewhere in each picture


def fit_outlines(
    robots: Sequence[Embodiment],
    T_world_base: Array,
    guess: Camera,
    footage: "Footage",
    advance: Callable[[float], None] = lambda _: None,
) -> tuple[CameraFit, float]:
    """Find a camera that stands still, and its lag.

    Outlines of end-effectors, and of the link that each is mounted on, are left out: covers, adapters and cables are there.

    Args:
        robots: that are seen, all on one base, the first being the dataset's.
        T_world_base: (4, 4) pose of the base.
        guess: the camera, to some 3 cm, 3 degrees and 3 % of the focal length; or what clicks say (`Clicks.camera`).
        footage: at least 8 pictures, in some of which the robot is fast: its lag is seen there.
        advance: called with the share of the work that is done.

    Returns:
        What was found, with the lag in `camera.lag_s`, and the share of the outlines at which there is an edge within two pixels.

    Raises:
        CEIError: nothing is found that both halves of the pictures agree on, or their edges are not the robots'.
    """
    extras.require_module("finding a camera", "cv2")
    if len(footage.pictures) < 8:
        raise CEIError(f"a camera is found by 8 pictures or more, not {len(footage.pictures)}.")
    view = RobotView(robots[0], T_world_base, guess, robots[1:])
    counts = np.concatenate([_of_arms(robot) for robot in robots])
    whole, *halves = [OutlineFit(view, part, counts) for part in (footage, footage.half(0), footage.half(1))]
    if not whole.is_seen(np.zeros(8)):
        raise CEIError(f"{robots[0].name} is not in the view of camera {guess.name!r} by the guess; give a better one.")
    ends: list[Array] = []
    for i, start in enumerate(_STARTS):
        ends.append(whole.refined(whole.lagged(start)))
        advance(0.7 * (i + 1) / len(_STARTS))
    best = max(ends, key=whole.met)
    # From different starts, where there are such that come to the same.
    same = [start for start, end in zip(_STARTS, ends, strict=True) if whole.apart_px(best, end)[0] < _MOST_APART_PX]
    sides = [half.refined(half.lagged(start)) for half, start in zip(halves, (same[0], same[-1]), strict=True)]
    advance(1.0)
    apart, most = whole.apart_px(*sides)
    met = whole.met(best)
    if not apart <= _MOST_APART_PX:
        raise CEIError(
            f"no camera is found: by one half of the pictures {guess.name!r} is {apart:.1f} pixels from where it is by the other (at most "
            f"{_MOST_APART_PX:g}); click some points of the robot, or give a better guess."
        )
    if met < _LEAST_MET:
        raise CEIError(
            f"no camera is found: pictures of {guess.name!r} have an edge at {100 * met:.0f} % of the robot's outline (at least {100 * _LEAST_MET:.0f}); click some "
            "points of the robot, or see whether joints and base are right."
        )
    camera, qpos = whole.camera(best), footage.qpos_at(best[7])
    last = RobotView(robots[0], T_world_base, camera, robots[1:])
    covered = [np.flatnonzero(grown(last.silhouette(q), MET_PX)) for q in qpos]
    pictures = np.rint(255 * footage.pictures).astype(np.uint8)
    agreed = agreement(pictures, covered, Plate.median(pictures, covered))
    return CameraFit(camera, apart, most, whole.apart_px(best, np.zeros(8))[0], agreed), met


def _of_arms(robot: Embodiment) -> Array:
    """(ngeom,) bool, which geoms' outlines are as they are described."""
    if robot.arm is None:
        return np.ones(robot.model.ngeom, bool)
    names = [robot.model.body(int(body)).name for body in robot.model.geom_bodyid]
    return np.array([not name.startswith(END_EFFECTOR_PREFIX) and name != robot.arm.mount_body for name in names])


@dataclass(frozen=True)
class Footage:
    """Pictures of a camera that stands still.

    Attributes:
        pictures: (N, H, W, 3) float32 in [0, 1].
        qpos_at: from a lag, s, to (N, n) joints that the pictures show by it, rad or m.
        clicks_at: likewise to what was clicked; None where nothing was.
    """

    pictures: Array
    qpos_at: Callable[[float], Array]
    clicks_at: Callable[[float], Clicks] | None = None

    def half(self, which: int) -> "Footage":
        """Every other picture, from the first (0) or the second (1), with every other click, or none where they are few."""
        clicks_at = self.clicks_at
        enough = clicks_at is not None and clicks_at(0.0).half(which) is not None
        return Footage(
            self.pictures[which::2],
            lambda lag_s: self.qpos_at(lag_s)[which::2],
            (lambda lag_s: cast("Clicks", clicks_at(lag_s).half(which))) if clicks_at is not None and enough else None,
        )


@dataclass(frozen=True)
class _Edges:
    """Outlines' points for which a picture has an edge.

    Attributes:
        points_world: (M, 3) m, at the lag at which they were drawn.
        speed: (M, 3) by which they move with it, m/s.
        edges: (M, 2) pixels.
        normals: (M, 2).
        weights: (M,) what each counts: what stands still in N pictures was seen once, not N times.
        missing: points without one.
    """

    points_world: Array
    speed: Array
    edges: Array
    normals: Array
    weights: Array
    missing: int


class OutlineFit:
    """A candidate is (8,): how the guess is turned (rotation vector, rad) and moved (m), in its own frame, the logarithm of the focal length's
    ratio, and the lag, s."""

    def __init__(self, view: RobotView, footage: Footage, counts: Array) -> None:
        """Args: the robots by the guessed camera; what it saw; (ngeom,) bool, whose outlines count."""
        self._view, self._footage, self._counts = view, footage, counts
        self._scale = view.camera.width / 640

    def camera(self, candidate: Array) -> Camera:
        """The camera that a candidate says."""
        guess, moved = self._view.camera, np.eye(4)
        moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec(candidate[:3]).as_matrix(), candidate[3:6]
        K = guess.K.copy()
        K[[0, 1], [0, 1]] *= np.exp(candidate[6])
        return replace(guess, K=K, T_world_camera=guess.T_world_camera @ moved, lag_s=float(candidate[7]))

    def is_seen(self, candidate: Array) -> bool:
        """Whether a candidate has any of the robots in view."""
        return any(self._view.silhouette(q).any() for q in self._footage.qpos_at(candidate[7]))

    def apart_px(self, one: Array, other: Array) -> tuple[float, float]:
        """Mean and largest distance in pictures of what one candidate sees of the arms' outlines, and the other; inf where it sees none."""
        seen = self._edges(one, REACHES_PX[0] * self._scale)
        pixels = [
            image_points(seen.points_world + (each[7] - one[7]) * seen.speed, self.camera(each))[0]
            for each in (one, other)
        ]
        off_px = np.linalg.norm(pixels[0] - pixels[1], axis=1)
        return (float(off_px.mean()), float(off_px.max())) if len(off_px) else (np.inf, np.inf)

    def lagged(self, candidate: Array) -> Array:
        """The candidate with the lag, of a few, by which outlines meet most edges where robots are fast."""
        qpos_at = self._footage.qpos_at
        fast = np.argsort(-np.abs(qpos_at(0.0) - qpos_at(0.1)).max(axis=1))[:_FAST]
        few = OutlineFit(
            self._view, Footage(self._footage.pictures[fast], lambda lag_s: qpos_at(lag_s)[fast]), self._counts
        )
        tried = [np.append(candidate[:7], lag_s) for lag_s in _LAGS_S]
        return max(tried, key=lambda each: few.met(each, REACHES_PX[0] / 4))

    def refined(self, candidate: Array, reaches_px: Sequence[float] = REACHES_PX) -> Array:
        """The candidate near one whose outlines are the pictures' edges."""
        for reach_px in reaches_px:
            candidate = self._met(candidate, reach_px * self._scale)
        return candidate

    def met(self, candidate: Array, within_px: float = MET_PX) -> float:
        """The share of the outlines that have an edge within some pixels."""
        seen = self._edges(candidate, 2 * within_px * self._scale)
        off_px = np.abs(self._off_px(candidate, candidate, seen))
        return float((off_px < within_px * self._scale).sum() / max(1, len(off_px) + seen.missing))

    def _met(self, start: Array, reach_px: float) -> Array:
        seen = self._edges(start, reach_px)
        spread_px = max(reach_px / 4, self._scale)
        share = np.sqrt(seen.weights * min(1.0, _COUNT / max(1.0, seen.weights.sum())))

        def residual(candidate: Array) -> Array:
            off = np.arcsinh(self._off_px(start, candidate, seen) / spread_px)  # a robust loss: far edges are others'
            rows = [share * off, candidate / _BELIEF]
            if self._footage.clicks_at is not None:
                clicks = self._footage.clicks_at(candidate[7])
                rows.append(clicks.off_px(self.camera(candidate)).ravel() / (CLICK_PX * self._scale))
            return np.concatenate(rows)

        return least_squares(residual, start, x_scale=_BELIEF / 10, max_nfev=30).x

    def _off_px(self, drawn: Array, candidate: Array, seen: _Edges) -> Array:
        """(M,) from edges to where a candidate has the outline, of which another was drawn."""
        points_world = seen.points_world + (candidate[7] - drawn[7]) * seen.speed
        return ((image_points(points_world, self.camera(candidate))[0] - seen.edges) * seen.normals).sum(axis=1)

    def _edges(self, candidate: Array, reach_px: float) -> _Edges:
        camera, lag_s, view = self.camera(candidate), candidate[7], self._view
        qpos = [self._footage.qpos_at(lag_s + by) for by in (-_MOMENT_S, 0.0, _MOMENT_S)]
        parts: list[tuple[Array, ...]] = []
        missing = 0
        placed = np.stack([view.poses(q)[:, :3, 3] for q in qpos[1]])
        moves = np.clip(
            np.linalg.norm(placed - placed.mean(axis=0), axis=-1).mean(axis=0) / _MOVES_M, 1 / len(placed), 1
        )
        for picture, before, now, after in zip(self._footage.pictures, *qpos, strict=True):
            outline = Outline.of(view.draw(now, 1, camera))
            off_px = edges_px(picture, outline, reach_px)
            at = np.flatnonzero(np.isfinite(off_px) & self._counts[outline.geom])
            missing += int((np.isnan(off_px) & self._counts[outline.geom]).sum())
            link, points = view.links[outline.geom[at]], outline.points_world[at]
            T = [view.poses(q)[link] for q in (before, now, after)]
            local = np.einsum("mji,mj->mi", T[1][:, :3, :3], points - T[1][:, :3, 3])
            ends = [np.einsum("mij,mj->mi", each[:, :3, :3], local) + each[:, :3, 3] for each in (T[0], T[2])]
            speed = (ends[1] - ends[0]) / (2 * _MOMENT_S)
            edges = outline.pixels[at] + off_px[at, None] * outline.normals[at]
            parts.append((points, speed, edges, outline.normals[at], moves[link]))
        points, speed, edges, normals, weights = (np.concatenate(each) for each in zip(*parts, strict=True))
        return _Edges(points, speed, edges, normals, weights, missing)
