"""Append whole episodes to a LeRobot v3.0 dataset.

LeRobot's own writer takes frames as a robot gives them, one by one, and spends most of its time on each. Here an episode
is one Arrow table from the start. Features, metadata, statistics and layout of files are LeRobot's, by its own functions.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cei_converters.dataset.columns import decode_array
from cei_converters.dataset.encoded import EncodedEpisode, encode_episode
from cei_converters.dataset.schema import POINT_CLOUD
from cei_converters.dataset.video_files import VideoFiles
from cei_gym.arrays import Array

_MB = 1024**2
_WITHOUT_STATISTICS = ("image", "video", "string", "language")


class EpisodeWriter:
    """Writes the files of one dataset; `finalize` completes them.

    Args:
        repo_id: name of the dataset.
        root: its folder, which must not exist.
        fps: frames a second.
        features: LeRobot's description of each column, without those that every dataset has (index, timestamp, ...).
        robot_type: what the dataset is of.
        tasks: those that have numbers already, in their order; others follow.
    """

    def __init__(
        self,
        repo_id: str,
        root: Path,
        *,
        fps: float,
        features: dict[str, dict[str, Any]],
        robot_type: str,
        tasks: Sequence[str] = (),
    ) -> None:
        from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata
        from lerobot.datasets.feature_utils import get_hf_features_from_features

        videos = any(feature["dtype"] == "video" for feature in features.values())
        self._meta = LeRobotDatasetMetadata.create(
            repo_id,
            fps=fps,  # pyright: ignore[reportArgumentType]  (declared whole, but only ever divided by)
            features=features,
            root=root,
            robot_type=robot_type,
            use_videos=videos,
        )
        if tasks:
            self._meta.save_episode_tasks(list(tasks))
        self._features = get_hf_features_from_features(self._meta.features)
        self._schema: pa.Schema = self._features.arrow_schema
        self._videos = VideoFiles(root, self._meta)
        self._file: pq.ParquetWriter | None = None
        self._place = 0, 0  # chunk, file

    def add(self, episode: EncodedEpisode) -> None:
        """Append an episode.

        Raises:
            CEIError: a video that it is a part of is not there any more.
        """
        frames = episode.table.num_rows
        each = episode.tasks or [episode.task] * frames
        tasks = list(dict.fromkeys(each))
        start = int(self._meta.total_frames)
        self._meta.save_episode_tasks(tasks)
        number = {task: self._meta.get_task_index(task) for task in tasks}
        frame_index = np.arange(frames)
        place_of_frames = {
            "timestamp": frame_index / self._meta.fps,
            "frame_index": frame_index,
            "episode_index": np.full(frames, self._meta.total_episodes),
            "index": start + frame_index,
            "task_index": np.array([number[task] for task in each]),
        }
        added = encode_episode(place_of_frames, self._meta.features, "").table
        columns = {key: episode.table[key] for key in episode.table.column_names}
        found = {**self._statistics(columns), **episode.statistics}
        found |= {key: _number_statistics(values) for key, values in place_of_frames.items()}
        self._write(self._cast(columns | {key: added[key] for key in added.column_names}))
        chunk, file = self._place
        place: dict[str, int | float] = {
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": start,
            "dataset_to_index": start + frames,
        }
        for key, clip in episode.clips.items():
            place |= self._videos.add(key, clip)
        for key, video in episode.videos.items():
            place |= self._videos.write(key, video, frames)
        own = {key: found[key] for key in self._meta.features if key in found}
        self._meta.save_episode(self._meta.total_episodes, frames, tasks, own, place)

    def _cast(self, columns: Mapping[str, Any]) -> pa.Table:
        """The rows of an episode, in the types in which `datasets` has LeRobot's features."""
        from datasets.table import cast_array_to_feature

        cast = [
            columns[key]
            if columns[key].type == kind
            else cast_array_to_feature(columns[key].combine_chunks(), self._features[key])
            for key, kind in zip(self._schema.names, self._schema.types, strict=True)
        ]
        return pa.Table.from_arrays(cast, schema=self._schema)

    def _statistics(self, columns: Mapping[str, Any]) -> dict[str, dict[str, Array]]:
        """LeRobot's statistics of columns of numbers, but for clouds: those of the 3072 entries of a flat one say nothing, and LeRobot
        would keep 220 kB of them an episode."""
        found = {}
        for key, column in columns.items():
            feature = self._meta.features[key]
            if key != POINT_CLOUD and feature["dtype"] not in _WITHOUT_STATISTICS:
                found[key] = _number_statistics(decode_array(column, feature, key, boolean=True))
        return found

    def finalize(self) -> None:
        """Complete the files. May be called more than once."""
        self._close_file()
        self._meta.finalize()

    def check(self) -> None:
        """Check that completed files can be read, and have all rows that were written.

        Raises:
            OSError: they cannot, or have not.
        """
        for folder, expected in (("data", self._meta.total_frames), ("meta/episodes", self._meta.total_episodes)):
            try:
                rows = sum(pq.read_metadata(path).num_rows for path in (self._meta.root / folder).glob("*/*.parquet"))
            except pa.ArrowException as error:
                raise OSError(f"what was written cannot be read back: {error}") from error
            if rows != expected:
                raise OSError(f"{self._meta.root / folder} has {rows} rows of the {expected} that were written.")

    def _write(self, table: pa.Table) -> None:
        """One row group an episode, so that a reader finds it without the others."""
        from lerobot.datasets.utils import update_chunk_file_indices

        path = self._path()
        if self._file is not None and path.stat().st_size + table.nbytes >= self._meta.data_files_size_in_mb * _MB:
            self._close_file()
            self._place = update_chunk_file_indices(*self._place, self._meta.chunks_size)
            path = self._path()
        if self._file is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            # coordinates hardly repeat: a dictionary of them is slow to make and larger than they are
            self._file = pq.ParquetWriter(path, table.schema, compression="zstd", use_dictionary=False)
        self._file.write_table(table)

    def _path(self) -> Path:
        chunk, file = self._place
        return self._meta.root / self._meta.data_path.format(chunk_index=chunk, file_index=file)

    def _close_file(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None


def _number_statistics(values: Array) -> dict[str, Array]:
    """As LeRobot's `compute_episode_stats`."""
    from lerobot.datasets.compute_stats import get_feature_stats

    values = values.reshape(len(values)) if values.shape[1:] == (1,) else values
    # of a single frame LeRobot's have other shapes than of more, so that no others can be added; twice is the same, but for the count
    stats = get_feature_stats(
        np.repeat(values, 2, axis=0) if len(values) == 1 else values, axis=0, keepdims=values.ndim == 1
    )
    return stats | {"count": np.array([len(values)])} if len(values) == 1 else stats
