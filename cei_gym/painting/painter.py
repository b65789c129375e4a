"""An episode's pictures with the target in the source's place."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cei_gym import extras
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import Embodiment
from cei_gym.painting.behind import Change, Plate, nearest_in_time
from cei_gym.painting.carried import Carry, CutOut, Layer, cut_out
from cei_gym.painting.light import Light
from cei_gym.painting.view import Drawn, RobotView

_FINENESS = 1, 2  # pixels to draw for one of the picture's, in each direction: recorded edges are hard or smooth
_LIT_FRAMES, _EDGE_FRAMES = 8, 3  # that light is read from, and how hard edges are
_SCENE_M = 0.01  # by so much recorded depth is nearer than the robot, before it hides it
_INPAINT_PX = 3


@dataclass(frozen=True)
class Figures:
    """How pictures were painted.

    Attributes:
        source: mean share of a picture that showed the source.
        pooled, invented: mean shares of a picture that no frame of the episode shows, and the target does not hide: taken from other
            episodes, or inpainted.
        light_off: median of what the light misses the source's pixels by, of 255; None where light is assumed.
        carried: how often something is carried.
        cut_out: how often it could be cut out.
    """

    source: float
    pooled: float
    invented: float
    light_off: float | None
    carried: int
    cut_out: int

    def record(self) -> dict[str, Any]:
        """As metadata have it."""
        return {name: round(value, 4) if isinstance(value, float) else value for name, value in vars(self).items()}


@dataclass(frozen=True)
class Shot:
    """What a fixed camera recorded of an episode, and what is known of it.

    Attributes:
        pictures: (T, H, W, 3) uint8.
        qpos: (T, n) the source's joints, rad or m.
        carries: when it carries something.
        depth_m: (T, H, W) along the optical axis, m, 0 where unknown; None where none is recorded.
    """

    pictures: Array
    qpos: Array
    carries: Sequence[Carry] = ()
    depth_m: Array | None = None


@dataclass(frozen=True)
class _Without:
    """A shot without the source.

    Attributes:
        robot: of each frame, the pixels that showed it.
        nearest: of each, the frame that shows what is behind; -1 where none does.
        cuts: what is carried.
    """

    robot: list[Array]
    nearest: list[Array]
    cuts: list[CutOut]


class Painter:
    """Paints a target over a source in one camera's pictures.

    Args:
        source, target: the robots.
        T_world_source, T_world_target: (4, 4) poses of their bases.
        camera: fixed; its calibration.
        margin_px: around the source's silhouette, what is taken out with it.
        plate: what is behind the source as other episodes show it.

    Raises:
        MissingExtra: OpenCV is not installed.
    """

    def __init__(
        self,
        source: Embodiment,
        target: Embodiment,
        T_world_source: Array,
        T_world_target: Array,
        camera: Camera,
        margin_px: float = 2.0,
        plate: Plate | None = None,
    ) -> None:
        extras.require_module("painting pictures", "cv2")
        self.camera, self.margin_px, self.plate = camera, margin_px, plate
        self._source = RobotView(source, T_world_source, camera)
        self._target = RobotView(target, T_world_target, camera)

    def __call__(self, shot: Shot, frames: Array, qpos: Array) -> tuple[Array, Figures]:
        """Paint an episode.

        Args:
            shot: what was recorded.
            frames: (T',) which of its frames each picture is of.
            qpos: (T', n') the target's joints in them, rad or m.

        Returns:
            (T', H, W, 3) uint8 pictures, and how they were painted.
        """
        light, without = self._light(shot), self._without(shot)
        finer = self._fineness(shot, without, light)
        painted = np.empty((len(frames), *shot.pictures.shape[1:]), np.uint8)
        pooled = invented = 0
        for i, t in enumerate(frames.tolist()):
            drawn = self._target.draw(qpos[i], finer)
            scene, never = self._uncovered(shot, without, t)
            scene, from_plate, made_up = self._completed(scene, never, drawn)
            pooled, invented = pooled + from_plate, invented + made_up
            layers = [cut.at(t, self.camera) for cut in without.cuts if cut.is_drawn(t, never)]
            layers = [layer.hard() for layer in layers] if finer == 1 else layers
            near_m = _with_layers(scene, without.robot[t], layers, None if shot.depth_m is None else shot.depth_m[t])
            painted[i] = _with_robot(scene, near_m, drawn, self._target.colours, light)
        pixels = painted[..., 0].size
        off = None if np.isnan(light.off) else 255 * light.off
        covered = sum(map(len, without.robot)) / shot.pictures[..., 0].size
        figures = Figures(covered, pooled / pixels, invented / pixels, off, len(shot.carries), len(without.cuts))
        return painted, figures

    def covered(self, qpos: Array) -> list[Array]:
        """Of each of (T, n) joint positions, (K,) the pixels that show the source, with the margin."""
        return [np.flatnonzero(grown(self._source.silhouette(q), self.margin_px)).astype(np.int32) for q in qpos]

    def _without(self, shot: Shot) -> _Without:
        robot = self.covered(shot.qpos)
        cuts: list[CutOut] = []
        changes: list[Change] = []
        for carry in shot.carries:
            cut, changed = cut_out(shot.pictures, robot, carry, self.camera)
            changes += changed
            cuts += [] if cut is None else [cut]
        covered = list(robot)
        for cut in cuts:
            for t in range(cut.carry.taken + 1, min(cut.carry.placed, len(robot))):
                there = grown(cut.at(t, self.camera).alpha > 0, self.margin_px)
                covered[t] = np.union1d(covered[t], np.flatnonzero(there))
        size = self.camera.height * self.camera.width
        return _Without(robot, nearest_in_time(size, robot, covered, changes), cuts)

    def _light(self, shot: Shot) -> Light:
        """The light in what was recorded, read from the source."""
        frames = _spread(len(shot.qpos), _LIT_FRAMES)
        drawn = [self._source.draw(shot.qpos[t]) for t in frames]
        return Light.read(drawn, [shot.pictures[t] / 255 for t in frames], self._source.colours, from_edges_px=2)

    def _fineness(self, shot: Shot, without: _Without, light: Light) -> int:
        """How finely robots are to be drawn, so that the source's edges are as they were recorded."""
        off = dict.fromkeys(_FINENESS, 0.0)
        for t in _spread(len(shot.qpos), _EDGE_FRAMES):
            inside = self._source.silhouette(shot.qpos[t])
            edge = grown(inside, 1) & grown(~inside, 1)
            behind, _ = self._uncovered(shot, without, t)
            for finer in _FINENESS:
                drawn = self._source.draw(shot.qpos[t], finer)
                again = _with_robot(behind.copy(), None, drawn, self._source.colours, light)
                off[finer] += float(np.abs(again[edge].astype(float) - shot.pictures[t][edge]).sum())
        return min(off, key=off.__getitem__)

    def _uncovered(self, shot: Shot, without: _Without, t: int) -> tuple[Array, Array]:
        """(H, W, 3) uint8, a frame without the source, and (H, W) bool, where no frame shows what is behind."""
        scene, never = shot.pictures[t].copy(), np.zeros(shot.pictures.shape[1:3], bool)
        pixels, nearest = without.robot[t], without.nearest[t]
        seen = nearest >= 0
        flat = shot.pictures.reshape(len(shot.pictures), -1, 3)
        scene.reshape(-1, 3)[pixels[seen]] = flat[nearest[seen], pixels[seen]]
        never.ravel()[pixels[~seen]] = True
        return scene, never

    def _completed(self, scene: Array, never: Array, drawn: Drawn) -> tuple[Array, int, int]:
        """The picture with what no frame of the episode shows, and of what the target does not hide how many pixels are from other episodes, and
        how many inpainted."""
        left = never.copy()
        left[drawn.part] &= drawn.share < 1
        if not left.any():
            return scene, 0, 0
        import cv2

        pooled = 0
        if self.plate is not None:
            known = never & self.plate.known
            scene[known] = self.plate.picture[known]
            pooled = int((left & known).sum())
            never, left = never & ~known, left & ~known
        if left.any():
            scene = cv2.inpaint(scene, never.astype(np.uint8), _INPAINT_PX, cv2.INPAINT_TELEA)
        return scene, pooled, int(left.sum())


def _with_layers(scene: Array, robot: Array, layers: Sequence[Layer], depth_m: Array | None) -> Array:
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


def _with_robot(scene: Array, near_m: Array | None, drawn: Drawn, own: Array, light: Light) -> Array:
    """Draw a robot with geoms of its own colours, but where something is nearer, in place."""
    colours, share, depth_m = light.on(drawn, own)
    if near_m is not None:
        share = np.where(near_m[drawn.part] < depth_m, 0.0, share)
    part = scene[drawn.part]
    scene[drawn.part] = np.rint(part + share[..., None] * (255 * colours - part))
    return scene


def _spread(count: int, most: int) -> list[int]:
    return np.unique(np.linspace(0, count - 1, most).round().astype(int)).tolist()


def grown(mask: Array, by_px: float) -> Array:
    """(H, W) bool, with what is within a distance."""
    import cv2

    if by_px <= 0:
        return mask
    size = 2 * int(np.ceil(by_px)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return cv2.dilate(mask.astype(np.uint8), kernel).astype(bool)
