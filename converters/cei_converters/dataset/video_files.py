"""Video files of a dataset that is being written."""

import shutil
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset.cameras import Clip
from cei_converters.dataset.decoding import decode_frames


class VideoFiles:
    """Puts episodes' videos into a dataset, as they are wherever that is possible.

    A file that episodes point into is copied once, whole, without decoding. An episode some of whose frames repeat gets a
    file of its own, encoded as its source was.

    Args:
        root: the dataset's folder.
        meta: its metadata, a `LeRobotDatasetMetadata`.
    """

    def __init__(self, root: Path, meta: Any) -> None:
        self._root, self._meta = root, meta
        self._copied: dict[tuple[str, Path], tuple[int, int]] = {}
        self._last: dict[str, tuple[int, int]] = {}

    def add(self, key: str, clip: Clip) -> dict[str, int | float]:
        """Put an episode's video into the dataset; returns where it is, for the episode's metadata."""
        start_s, end_s = clip.start_s, clip.end_s
        if clip.frames is not None:
            place = self._next(key)
            self._encode(key, clip, self._path(key, place))
            start_s, end_s = 0.0, len(clip.frames) / self._meta.fps
        else:
            if (key, clip.path) not in self._copied:
                self._copied[key, clip.path] = self._next(key)
                shutil.copyfile(clip.path, self._path(key, self._copied[key, clip.path]))
            place = self._copied[key, clip.path]
        names = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
        return {f"videos/{key}/{name}": value for name, value in zip(names, (*place, start_s, end_s), strict=True)}

    def _next(self, key: str) -> tuple[int, int]:
        from lerobot.datasets.utils import update_chunk_file_indices

        last = self._last.get(key)
        self._last[key] = (0, 0) if last is None else update_chunk_file_indices(*last, self._meta.chunks_size)
        self._path(key, self._last[key]).parent.mkdir(parents=True, exist_ok=True)
        return self._last[key]

    def _path(self, key: str, place: tuple[int, int]) -> Path:
        chunk, file = place
        return self._root / self._meta.video_path.format(video_key=key, chunk_index=chunk, file_index=file)

    def _encode(self, key: str, clip: Clip, path: Path) -> None:
        from lerobot.configs.video import encoder_config_from_video_info, rgb_encoder_defaults
        from lerobot.datasets.image_writer import write_image
        from lerobot.datasets.video_utils import encode_video_frames

        assert clip.frames is not None
        fps = self._meta.fps
        times_s = clip.start_s + np.arange(clip.frames.max() + 1) / fps
        pictures = decode_frames(clip.path, times_s, fps)
        try:
            encoder = encoder_config_from_video_info(self._meta.features[key].get("info"))
        except ValueError:  # a codec that can be read here but not written
            encoder = rgb_encoder_defaults()
        with tempfile.TemporaryDirectory(dir=self._root) as folder:
            for i, frame in enumerate(clip.frames):
                write_image(pictures[frame], Path(folder, f"frame-{i:06d}.png"))
            rate = fps if fps == int(fps) else Fraction(fps).limit_denominator(1001)
            encode_video_frames(folder, path, rate, encoder)  # pyright: ignore[reportArgumentType]  (FFmpeg's rates are fractions)
