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
from cei_gym.painting.carried import Carry, CutOut, cut_out
from cei_gym.painting.composite import completed, fineness, grown, with_layers, with_robot
from cei_gym.painting.light import Light
from cei_gym.painting.view import RobotView

_LIT_FRAMES, _EDGE_FRAMES = 8, 3  # that light is read from, and how hard edges are


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
            scene, from_plate, made_up = completed(scene, never, drawn, self.plate)
            pooled, invented = pooled + from_plate, invented + made_up
            layers = [cut.at(t, self.camera) for cut in without.cuts if cut.is_drawn(t, never)]
            layers = [layer.hard() for layer in layers] if finer == 1 else layers
            near_m = with_layers(scene, without.robot[t], layers, None if shot.depth_m is None else shot.depth_m[t])
            painted[i] = with_robot(scene, near_m, drawn, self._target.colours, light)
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
        few = _spread(len(shot.qpos), _EDGE_FRAMES)
        seen = [(shot.qpos[t], self._uncovered(shot, without, t)[0], shot.pictures[t]) for t in few]
        return fineness(self._source, seen, light)

    def _uncovered(self, shot: Shot, without: _Without, t: int) -> tuple[Array, Array]:
        """(H, W, 3) uint8, a frame without the source, and (H, W) bool, where no frame shows what is behind."""
        scene, never = shot.pictures[t].copy(), np.zeros(shot.pictures.shape[1:3], bool)
        pixels, nearest = without.robot[t], without.nearest[t]
        seen = nearest >= 0
        flat = shot.pictures.reshape(len(shot.pictures), -1, 3)
        scene.reshape(-1, 3)[pixels[seen]] = flat[nearest[seen], pixels[seen]]
        never.ravel()[pixels[~seen]] = True
        return scene, never


def _spread(count: int, most: int) -> list[int]:
    return np.unique(np.linspace(0, count - 1, most).round().astype(int)).tolist()
