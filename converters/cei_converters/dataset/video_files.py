"""Video files of a dataset that is being written."""

import shutil
from pathlib import Path
from typing import Any

from cei_converters.dataset.cameras import Clip
from cei_gym.errors import CEIError


class VideoFiles:
    """Puts episodes' videos into a dataset.

    A file that episodes point into is copied once, whole, without decoding.

    Args:
        root: the dataset's folder.
        meta: its metadata, a `LeRobotDatasetMetadata`.
    """

    def __init__(self, root: Path, meta: Any) -> None:
        self._root, self._meta = root, meta
        self._copied: dict[tuple[str, Path], tuple[int, int]] = {}
        self._last: dict[str, tuple[int, int]] = {}

    def add(self, key: str, clip: Clip) -> dict[str, int | float]:
        """Put a part of a file into the dataset; returns where it is, for the episode's metadata.

        Raises:
            CEIError: the file is not there any more.
        """
        if (key, clip.path) not in self._copied:
            if not clip.path.is_file():
                raise CEIError(f"{clip.path} is missing; download the dataset with its videos.")
            self._copied[key, clip.path] = self._next(key)
            shutil.copyfile(clip.path, self._path(key, self._copied[key, clip.path]))
        return _where(key, self._copied[key, clip.path], clip.start_s, clip.end_s)

    def write(self, key: str, video: bytes, frames: int) -> dict[str, int | float]:
        """The same with an MP4 file of the episode alone."""
        place = self._next(key)
        self._path(key, place).write_bytes(video)
        return _where(key, place, 0.0, frames / self._meta.fps)

    def _next(self, key: str) -> tuple[int, int]:
        from lerobot.datasets.utils import update_chunk_file_indices

        last = self._last.get(key)
        self._last[key] = (0, 0) if last is None else update_chunk_file_indices(*last, self._meta.chunks_size)
        self._path(key, self._last[key]).parent.mkdir(parents=True, exist_ok=True)
        return self._last[key]

    def _path(self, key: str, place: tuple[int, int]) -> Path:
        chunk, file = place
        return self._root / self._meta.video_path.format(video_key=key, chunk_index=chunk, file_index=file)


def _where(key: str, place: tuple[int, int], start_s: float, end_s: float) -> dict[str, int | float]:
    names = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
    return {f"videos/{key}/{name}": value for name, value in zip(names, (*place, start_s, end_s), strict=True)}
