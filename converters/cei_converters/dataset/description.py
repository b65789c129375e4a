"""What a LeRobot v3.0 dataset's `meta/` says of it, read with Arrow alone.

LeRobot's own class for it imports torch, torchvision and diffusers, six seconds on a core, before a word can be said about a dataset.
Names and meanings of what is here are that class's (`LeRobotDatasetMetadata`); writing is LeRobot's.
"""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cei_converters.dataset.hidden import visible
from cei_converters.dataset.locate import read_info
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_json

EPISODES_FOLDER, TASKS_PATH, STATISTICS_PATH = "meta/episodes", "meta/tasks.parquet", "meta/stats.json"
EPISODES_PATH = EPISODES_FOLDER + "/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_STATISTICS = "stats/"


class Description:
    """A dataset that has been checked (`info.check_info`, `info.check_episodes`).

    Args:
        root: its folder.

    Attributes:
        root: as given.
        features: LeRobot's description of each column, shapes as tuples.
        fps: frames a second.
        total_episodes: how many episodes there should be.
        episodes: what is known of each, a row an episode, without statistics.

    Raises:
        OSError, ValueError: a file cannot be read.
    """

    def __init__(self, root: Path) -> None:
        self.root, self._info = root, read_info(root)
        self.fps: float = self._info["fps"]
        self.total_episodes: int = self._info["total_episodes"]
        self.features: dict[str, dict[str, Any]] = {
            key: feature | {"shape": tuple(feature["shape"])} for key, feature in self._info["features"].items()
        }
        self.episodes = _read_episodes(root)

    def episode(self, index: int) -> dict[str, Any]:
        """What is known of one episode: its length, its tasks, where its frames and videos are."""
        return self.episodes.slice(index, 1).to_pylist()[0]

    @property
    def data_path(self) -> str:
        """Template of the path of a file of frames."""
        return self._info.get("data_path", _DATA_PATH)

    @property
    def video_path(self) -> str | None:
        """Template of the path of a video; None if nothing says where they are."""
        return self._info.get("video_path", _VIDEO_PATH)

    def data_file(self, index: int) -> Path:
        """Where an episode's frames are, below the dataset's folder."""
        known = self.episode(index)
        return Path(self.data_path.format(chunk_index=known["data/chunk_index"], file_index=known["data/file_index"]))

    def video_file(self, index: int, key: str) -> Path:
        """Where an episode's video is, below the dataset's folder.

        Raises:
            KeyError: nothing says where.
        """
        if self.video_path is None:
            raise KeyError("video_path")
        known = self.episode(index)
        chunk, file = known[f"videos/{key}/chunk_index"], known[f"videos/{key}/file_index"]
        return Path(self.video_path.format(video_key=key, chunk_index=chunk, file_index=file))

    @property
    def image_keys(self) -> list[str]:
        """Features that are images."""
        return [key for key, feature in self.features.items() if feature["dtype"] == "image"]

    @property
    def video_keys(self) -> list[str]:
        """Features that are videos."""
        return [key for key, feature in self.features.items() if feature["dtype"] == "video"]

    @property
    def camera_keys(self) -> list[str]:
        """Features that are images or videos, in their order."""
        return [key for key, feature in self.features.items() if feature["dtype"] in ("image", "video")]

    @property
    def depth_keys(self) -> list[str]:
        """Features that are marked as depth, as any version of LeRobot marks them."""
        return [key for key, feature in self.features.items() if _is_depth(feature)]

    @cached_property
    def tasks(self) -> pa.Table:
        """The table of tasks, as it is stored.

        Raises:
            OSError, ValueError: it cannot be read.
        """
        return pq.ParquetFile(self.root / TASKS_PATH).read()

    @cached_property
    def statistics(self) -> dict[str, dict[str, Array]]:
        """Feature to statistics of the whole dataset; empty where there are none.

        Raises:
            CEIError: they cannot be read.
        """
        path = self.root / STATISTICS_PATH
        try:
            found = load_json(path.read_text()) if path.is_file() else {}
            return {key: {name: np.array(value) for name, value in stats.items()} for key, stats in found.items()}
        except (OSError, ValueError, AttributeError) as error:
            raise CEIError(f"{path} cannot be read: {one_line(error)}.") from error


def _read_episodes(root: Path) -> pa.Table:
    """The table of episodes, of all its files in their order, without statistics: those of a million would fill the memory."""
    tables = []
    for path in visible(root, f"{EPISODES_FOLDER}/*/*.parquet"):
        file = pq.ParquetFile(path)
        tables.append(file.read([name for name in file.schema_arrow.names if not name.startswith(_STATISTICS)]))
    return pa.concat_tables(tables, promote_options="permissive").combine_chunks()


def _is_depth(feature: Mapping[str, Any]) -> bool:
    info, video_info = feature.get("info") or {}, feature.get("video_info") or {}
    marks = info.get("is_depth_map"), info.get("video.is_depth_map"), video_info.get("video.is_depth_map")
    return any(marks)
