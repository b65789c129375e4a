"""RGB cameras of a dataset that is converted. Their pictures pass through as they are and show the source robot, unless a step paints others."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cei_converters.dataset.columns import read_columns
from cei_converters.dataset.decoding import check_video, decode_frames, decode_pictures, encoded_images
from cei_converters.dataset.description import EPISODES_PATH, Description
from cei_converters.dataset.rows import read_rows
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line, unknown


@dataclass(frozen=True)
class Clip:
    """An episode's part of a video file.

    Attributes:
        path: the file.
        start_s, end_s: where in it.
        fps: frames a second.
        frames: (T,) which of the episode's frames are wanted; None for all, each once.
    """

    path: Path
    start_s: float
    end_s: float
    fps: float
    frames: Array | None = None

    def at(self, frames: Array) -> "Clip":
        """The clip with its frames at these indices, in this order."""
        return replace(self, frames=frames if self.frames is None else self.frames[frames])

    def decode(self) -> Array:
        """Its pictures, (T, H, W, 3) uint8.

        Raises:
            CEIError: the file cannot be decoded.
        """
        frames = np.arange(round((self.end_s - self.start_s) * self.fps)) if self.frames is None else self.frames
        return decode_frames(self.path, self.start_s + frames / self.fps, self.fps).transpose(0, 2, 3, 1)


@dataclass(frozen=True)
class Pictures:
    """What RGB cameras saw of one episode, as it is stored, and what steps have painted instead.

    Attributes:
        images: feature key to (T,) cells of encoded images (`bytes`, `path`).
        clips: feature key to the episode's part of a video.
        statistics: feature key to LeRobot's statistics of the episode, which repeating frames is not held to change.
        features: feature key to LeRobot's description, of all cameras.
        painted: feature key to (T, H, W, 3) uint8 pictures, which are not encoded yet.
    """

    images: Mapping[str, pa.Array] = field(default_factory=dict[str, pa.Array])
    clips: Mapping[str, Clip] = field(default_factory=dict[str, Clip])
    statistics: Mapping[str, dict[str, Array]] = field(default_factory=dict[str, dict[str, Array]])
    features: Mapping[str, dict[str, Any]] = field(default_factory=dict[str, dict[str, Any]])
    painted: Mapping[str, Array] = field(default_factory=dict[str, Array])

    def at(self, frames: Array | None) -> "Pictures":
        """The pictures with their frames at these indices, in this order; None changes nothing."""
        if frames is None:
            return self
        return replace(
            self,
            images={key: cells.take(pa.array(frames)) for key, cells in self.images.items()},
            clips={key: clip.at(frames) for key, clip in self.clips.items()},
            painted={key: pictures[frames] for key, pictures in self.painted.items()},
        )

    def decode(self, key: str) -> Array:
        """A camera's pictures, (T, H, W, 3) uint8.

        Raises:
            CEIError: there is no such camera, or its pictures cannot be decoded.
        """
        if key in self.painted:
            return self.painted[key]
        if key in self.clips:
            return self.clips[key].decode()
        if key not in self.images:
            raise unknown("camera", key, self.features)
        return decode_pictures(self.images[key], self.features[key], key)

    def paint(self, key: str, pictures: Array) -> "Pictures":
        """The same with other pictures of a camera.

        Args:
            key: the camera's feature.
            pictures: (T, H, W, 3) uint8, as many and as large as those that there are.

        Raises:
            CEIError: there is no such camera, or pictures are of another size or type.
        """
        if key not in self.features:
            raise unknown("camera", key, self.features)
        size = tuple(self.features[key]["shape"])
        if pictures.dtype != np.uint8 or pictures.shape[1:] != size:
            raise CEIError(
                f"{key} is painted as {pictures.dtype} of shape {pictures.shape}; it should be uint8 of shape (T, {', '.join(map(str, size))})."
            )
        left = {name: {k: v for k, v in getattr(self, name).items() if k != key} for name in ("images", "clips")}
        statistics = {k: v for k, v in self.statistics.items() if k != key}
        return replace(self, **left, statistics=statistics, painted={**self.painted, key: pictures})

    def check_frames(self, frames: int, repeated: bool) -> None:
        """Check that all are of as many frames.

        Args:
            frames: how many there should be.
            repeated: whether they are others than the source's.

        Raises:
            CEIError: a camera has more or fewer.
        """
        lengths = {key: len(pictures) for key, pictures in (*self.images.items(), *self.painted.items())}
        lengths |= {key: len(clip.frames) for key, clip in self.clips.items() if clip.frames is not None}
        whole = [key for key, clip in self.clips.items() if clip.frames is None and repeated]
        for key in sorted({key for key, length in lengths.items() if length != frames} | {*whole}):
            raise CEIError(
                f"{key} has {lengths.get(key, "the source's")} frames, where the demonstration has {frames}; what cuts one should cut the other, by `at`."
            )


def read_pictures(root: Path, meta: Description, index: int, keys: Sequence[str]) -> Pictures:
    """What an episode's cameras saw.

    Args:
        root: the dataset's folder.
        meta: what it says of itself.
        index: the episode.
        keys: the cameras' features.

    Raises:
        CEIError: a picture, a video or statistics are missing.
    """
    if not keys:
        return Pictures()
    images = [key for key in keys if key in meta.image_keys]
    table = read_columns(root, meta, index, images)
    cells = {key: table[key].combine_chunks() for key in images}
    for key in images:
        if not all(encoded_images(cells[key], f"episode {index}, {key}")):
            raise CEIError(f"episode {index}, {key}: a picture is missing; download or record the dataset again.")
        cells[key] = _without_folders(cells[key])
    clips = {key: find_clip(root, meta, index, key) for key in keys if key in meta.video_keys}
    features = {key: meta.features[key] for key in (*cells, *clips)}
    return Pictures(cells, clips, _statistics(root, meta, index, keys), features)


def _without_folders(cells: Any) -> pa.Array:
    """Encoded images whose `path`, which nobody reads, is a name: it may say where they were on the machine that recorded them."""
    fields = {field.name: cells.field(i) for i, field in enumerate(cells.type)}
    paths = fields["path"].to_pylist() if "path" in fields else []
    names = [re.split(r"[/\\]", path)[-1] if isinstance(path, str) else None for path in paths or [None] * len(cells)]
    encoded = fields["bytes"].cast(pa.binary())
    return pa.StructArray.from_arrays([encoded, pa.array(names, pa.string())], names=["bytes", "path"])


def find_clip(root: Path, meta: Description, index: int, key: str) -> Clip:
    """The part of a video that is an episode's.

    Raises:
        CEIError: the file is missing, damaged or not the dataset's, or nothing says which it is.
    """
    try:
        path = meta.video_file(index, key)
        start_s, end_s = (float(meta.episode(index)[f"videos/{key}/{end}_timestamp"]) for end in ("from", "to"))
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise CEIError(f"episode {index}: {root.name}/meta does not say where the video of {key} is.") from error
    if path.is_absolute() or ".." in path.parts:
        raise CEIError(f"{root.name}: video_path {meta.video_path!r} leads out of the dataset.")
    try:
        there = (root / path).is_file()
    except (OSError, ValueError):  # a name that no file can have
        there = False
    if not there:
        raise CEIError(f"episode {index}: {root / path} is missing; download the dataset with its videos.")
    length_s = check_video(root / path)
    if not 0 <= start_s < end_s <= length_s + 1 / meta.fps:
        raise CEIError(
            f"episode {index}: {key} should be from {start_s:g} to {end_s:g} s of {root / path}, which is {length_s:g} s long."
        )
    return Clip(root / path, start_s, end_s, meta.fps)


def _statistics(root: Path, meta: Description, index: int, keys: Sequence[str]) -> dict[str, dict[str, Array]]:
    """LeRobot's statistics of features in an episode, or in the dataset where episodes have none."""
    try:
        chunk, file = (meta.episode(index)[f"meta/episodes/{name}_index"] for name in ("chunk", "file"))
        path = root / EPISODES_PATH.format(chunk_index=chunk, file_index=file)
        (stored,) = read_rows(path, index).to_pylist()
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise CEIError(f"episode {index}: {root}/meta/episodes has no statistics of it ({one_line(error)}).") from error
    found = {}
    for key in keys:
        prefix = f"stats/{key}/"
        own = {name.removeprefix(prefix): np.array(stored[name]) for name in stored if name.startswith(prefix)}
        found[key] = own or meta.statistics.get(key)
        if not found[key]:
            raise CEIError(
                f"{key} has no statistics, without which nothing can be trained on it; "
                "compute them with: lerobot-edit-dataset --operation.type=recompute_stats."
            )
    return found
