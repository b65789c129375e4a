"""Pictures of a conversion in which the target is painted over the source (`cei_gym.painting`)."""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from cei_converters.conversion.cameras import CameraOptions, calibrated
from cei_converters.conversion.episode import Recorded, Retargeted
from cei_converters.sources.recording import spread
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera, Demonstration
from cei_gym.errors import CEIError
from cei_gym.painting import Agreement, Painter, Plate, Shot, agreement, carries, delayed

if TYPE_CHECKING:
    from cei_converters.sources.source import Source
    from cei_gym.transfer import Transfer

_EPISODES, _FRAMES = 8, 8  # that are looked at for what is behind the robot, and of each
_LEAST_COVERED = 0.0005
_LEAST_EXPLAINED, _DOUBTFUL = 0.5, 0.85
_LEAST_STILL = 0.75  # a large object that is carried, and a body that sways a little, are left


class Painting:
    """Paints what cameras saw of a dataset's episodes.

    Args:
        reader: what episodes are read from.
        transfer: that moves them.
        keys: LeRobot's features of the cameras, which are calibrated.
        episodes: of the dataset, that are converted.
        options: see there.

    Raises:
        CEIError: a camera is not calibrated.
    """

    def __init__(
        self,
        reader: "Source",
        transfer: "Transfer",
        keys: Mapping[str, Mapping[str, Any]],
        episodes: Sequence[int],
        options: CameraOptions,
    ) -> None:
        self._reader, self._transfer, self._options = reader, transfer, options
        self._episodes = list(dict.fromkeys(episodes))
        self.cameras = calibrated(keys, reader.scene.cameras)
        self._lock = threading.Lock()
        self._plates: dict[str, Plate] = {}
        self._painters: dict[str, Painter] = {}

    def look(self) -> dict[str, Agreement]:
        """Look at some pictures of each camera: what is behind the robot, and whether the calibration is the camera's.

        Raises:
            CEIError: the robot is not in a camera's pictures, the camera moves, or its calibration is wrong.
        """
        return {key: self._look(key, camera) for key, camera in self.cameras.items()}

    def __call__(self, made: Retargeted) -> Retargeted:
        """The episode with the target painted in its pictures.

        Raises:
            CEIError: pictures cannot be decoded, or are not of as many frames as joints.
        """
        recorded, moved = made.recorded.demonstration, made.demonstration
        of_source = recorded.source_frames
        frames = np.arange(len(moved)) if moved.source_frames is None else moved.source_frames
        if of_source is not None:
            frames = np.searchsorted(of_source, frames)
        pictures, painted = made.pictures, dict[str, dict[str, Any]]()
        for key, camera in self.cameras.items():
            shot = self._shot(made.recorded, moved.scene.T_world_base, key, camera)
            qpos = delayed(moved.qpos, camera.lag_s * recorded.fps)  # by as much as the scene around it
            shown, figures = self._painter(key, recorded, moved)(shot, frames, qpos)
            pictures, painted[key] = pictures.paint(key, shown), figures.record()
        return replace(made, pictures=pictures, painted=painted)

    def _shot(self, recorded: Recorded, T_world_target: Array, key: str, camera: Camera) -> Shot:
        demonstration = recorded.demonstration
        demonstration = replace(demonstration, qpos=delayed(demonstration.qpos, camera.lag_s * demonstration.fps))
        pictures = recorded.pictures.decode(key)
        if demonstration.source_frames is not None:
            pictures = pictures[demonstration.source_frames]
        if len(pictures) != len(demonstration):
            raise CEIError(
                f"episode {recorded.index}: {key} has {len(pictures)} pictures, where joints have {len(demonstration)} frames; record it again."
            )
        carried = carries(self._transfer.motion(demonstration), T_world_target)
        return Shot(pictures, demonstration.qpos, carried, demonstration.depth_m.get(camera.name))

    def _painter(self, key: str, recorded: Demonstration, moved: Demonstration) -> Painter:
        with self._lock:
            if key not in self._painters:
                if key not in self._plates:
                    self._look(key, self.cameras[key])
                self._painters[key] = Painter(
                    self._transfer.source,
                    self._transfer.target,
                    recorded.scene.T_world_base,
                    moved.scene.T_world_base,
                    self.cameras[key],
                    self._options.margin_px,
                    self._plates[key],
                )
            return self._painters[key]

    def _look(self, key: str, camera: Camera) -> Agreement:
        source, base = self._transfer.source, self._reader.scene.T_world_base
        robot = Painter(source, source, base, base, camera, self._options.margin_px)
        pictures: list[Array] = []
        covered: list[Array] = []
        for which in spread(len(self._episodes), _EPISODES):
            index = self._episodes[which]
            qpos = delayed(self._reader.read(index, clouds=False).qpos, camera.lag_s * self._reader.fps)
            few = np.array([*spread(len(qpos), _FRAMES)])
            pictures.append(self._reader.pictures(index).at(few).decode(key))
            covered += robot.covered(qpos[few])
        sampled = np.concatenate(pictures)
        self._plates[key] = plate = Plate.median(sampled, covered)
        found = agreement(sampled, covered, plate)
        name = self._transfer.source.name
        if found.covered < _LEAST_COVERED:
            raise CEIError(
                f"--cameras.paint: {name} is not in the pictures of {key} by its calibration and joints; is T_world_camera, the camera's pose in the "
                "world, right?"
            )
        if found.still < _LEAST_STILL:
            raise CEIError(
                f"--cameras.paint: pictures of {key} change all over ({100 - 100 * found.still:.0f} % of them), so that the camera moves, which cannot be "
                "painted; leave it out with --cameras.keep."
            )
        if max(found.explained, found.filled) < _LEAST_EXPLAINED:  # what is carried may be larger than the robot
            raise CEIError(
                f"--cameras.paint: of what moves in pictures of {key} only {100 * found.explained:.0f} % is where {name} should be, so that its calibration "
                "(or the joints, or the base's pose) is wrong; nothing is painted by it."
            )
        return found


def in_words(found: Mapping[str, Agreement], target: str) -> str:
    """A line: what is painted, and how far pictures bear out the calibrations."""
    each = ", ".join(
        f"{key} (of what moves in it {100 * of.explained:.0f} % is where joints say)" for key, of in found.items()
    )
    text = f"Pictures are painted with {target}: {each}."
    doubtful = [key for key, of in found.items() if of.explained < _DOUBTFUL]
    if doubtful:
        text += (
            f"\nwarning: what else moves in pictures of {', '.join(doubtful)} is of objects or shadows, or the calibration is off by some pixels, so that "
            "the old robot shows at its edges: look at some (cei-view)."
        )
    return text
