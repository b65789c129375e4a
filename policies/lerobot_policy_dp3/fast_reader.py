"""Reads windows of LeRobot datasets a hundred times as fast as LeRobot 0.6.1, with the same results.

LeRobot decodes every column of every frame of a window into Python numbers, point clouds included. Here numbers are looked at
where they lie, in memory-mapped Arrow tables; text and pictures still go LeRobot's way.
"""

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import datasets
import lerobot
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import torch
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_reader import DEPTH_METER_UNIT, MM_PER_METRE, DatasetReader
from lerobot.datasets.io_utils import hf_transform_to_torch

SLOW = ("0.6.1",)
"""Versions of LeRobot that need this, and that it has been tested with."""


def install() -> bool:
    """Make `LeRobotDataset` read this way, in LeRobot versions that need it.

    Returns:
        Whether it does now.
    """
    if lerobot.__version__ not in SLOW:
        logging.info("LeRobot %s reads its own way; fast reading is for %s.", lerobot.__version__, ", ".join(SLOW))
        return False
    if lerobot_dataset.DatasetReader is DatasetReader:
        lerobot_dataset.DatasetReader = FastReader
    return lerobot_dataset.DatasetReader is FastReader


class FastReader(DatasetReader):
    """LeRobot's reader, with `get_item` made fast."""

    def get_item(self, idx: int) -> dict[str, Any]:
        """One frame, with its windows; see LeRobot's."""
        columns = self.columns
        if columns is None:
            return super().get_item(idx)
        idx = range(len(self._table))[idx]  # from the end, and out of range, as LeRobot's
        item = dict(self._others[idx]) if self._others is not None else {}
        item |= {key: column.at(idx) for key, column in columns.items()}
        episode, frame = int(item["episode_index"]), int(item["index"])
        query = None
        if self.delta_indices is not None:
            query, padding = self._get_query_indices(frame, episode)
            item |= padding
            slow = {}
            for key, rows in query.items():
                if key in columns:
                    item[key] = columns[key].at(self._relative(rows))
                else:
                    slow[key] = rows
            item |= self._query_hf_dataset(slow)
        if self._meta.video_keys:
            timestamps = self._get_query_timestamps(item["timestamp"].item(), query)
            item = self._query_videos(timestamps, episode) | item
        if self._image_transforms is not None:
            for key in set(self._meta.camera_keys) - set(self._meta.depth_keys):
                item[key] = self._image_transforms(item[key])
        for key, unit in self._image_depth_units.items():
            if key in item and unit is not None and unit != self._depth_output_unit:
                item[key] = item[key] * MM_PER_METRE if unit == DEPTH_METER_UNIT else item[key] / MM_PER_METRE
        item["task"] = self._task_names[int(item["task_index"])]
        return item

    def _get_query_indices(self, abs_idx: int, ep_idx: int):
        starts, ends = self._bounds
        start, end = starts[ep_idx], ends[ep_idx]
        query, padding = {}, {}
        for key, delta in self._deltas.items():
            rows = abs_idx + delta
            query[key] = np.clip(rows, start, end - 1)
            padding[f"{key}_is_pad"] = torch.from_numpy((rows < start) | (rows >= end))
        return query, padding

    def _get_query_timestamps(self, current_ts: float, query_indices=None) -> dict[str, list[float]]:
        query, columns = query_indices or {}, self.columns
        if columns is None:
            return super()._get_query_timestamps(current_ts, query_indices)
        return {
            key: columns["timestamp"].at(self._relative(query[key])).tolist() if key in query else [current_ts]
            for key in self._meta.video_keys
        }

    def _query_hf_dataset(self, query_indices):
        if self._others is None:
            return super()._query_hf_dataset(query_indices)
        rows = {
            key: self._relative(rows).tolist()
            for key, rows in query_indices.items()
            if key not in self._meta.video_keys
        }
        return {key: torch.stack(self._others[key][some]) for key, some in rows.items()}

    def _relative(self, rows: np.ndarray | list[int]) -> np.ndarray:
        """Rows of the table, which holds only some episodes, for frames of the dataset."""
        if self._absolute_to_relative_idx is None:
            return np.asarray(rows)
        return np.array([self._absolute_to_relative_idx[int(row)] for row in rows])

    @cached_property
    def columns(self) -> "dict[str, Column] | None":
        """The columns that are read fast, by key: those of numbers. None where LeRobot reads all: rows are not in the table's order, or a
        column that every dataset has is missing."""
        if self.hf_dataset is None or self._table._indices is not None:
            return None
        columns = {key: column_of(self._table, key) for key in self._table.column_names}
        found = {key: column for key, column in columns.items() if column is not None}
        return found if {"index", "episode_index", "task_index", "timestamp"} <= set(found) else None

    @cached_property
    def _others(self) -> datasets.Dataset | None:
        """The rest of the table, decoded as LeRobot does; None if there is none."""
        rest = [key for key in self._table.column_names if key not in (self.columns or {})]
        return self._table.select_columns(rest).with_transform(hf_transform_to_torch) if rest else None

    @property
    def _table(self) -> datasets.Dataset:
        assert self.hf_dataset is not None
        return self.hf_dataset

    @cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        episodes = self._meta.episodes
        assert episodes is not None
        return np.asarray(episodes["dataset_from_index"]), np.asarray(episodes["dataset_to_index"])

    @cached_property
    def _deltas(self) -> dict[str, np.ndarray]:
        return {key: np.asarray(delta) for key, delta in (self.delta_indices or {}).items()}

    @cached_property
    def _task_names(self) -> list[str]:
        assert self._meta.tasks is not None
        return list(self._meta.tasks.index)

    def __getstate__(self) -> dict[str, Any]:
        lazy = ("columns", "_others", "_bounds", "_deltas", "_task_names")  # views, which workers make for themselves
        return {key: value for key, value in self.__dict__.items() if key not in lazy}


@dataclass(frozen=True)
class Column:
    """A column of numbers as arrays (rows, ...) that share the table's memory, one a chunk.

    Attributes:
        chunks: the arrays.
        starts: (chunks + 1,) rows at which they start, and the end.
        dtype: of what is returned: LeRobot's tensors are made of Python numbers.
    """

    chunks: list[np.ndarray]
    starts: np.ndarray
    dtype: type

    def at(self, rows: int | np.ndarray) -> torch.Tensor:
        """One row, or several (R, ...), copied."""
        if isinstance(rows, np.ndarray):
            first = self._chunk(int(rows.min()))
            if first == self._chunk(int(rows.max())):
                found = self.chunks[first][rows - self.starts[first]]
            else:
                found = np.stack([self._row(int(row)) for row in rows])
        else:
            found = self._row(rows)
        return torch.from_numpy(np.array(found, dtype=self.dtype))

    def _chunk(self, row: int) -> int:
        return int(np.searchsorted(self.starts, row, side="right")) - 1 if len(self.chunks) > 1 else 0

    def _row(self, row: int) -> np.ndarray:
        chunk = self._chunk(row)
        return self.chunks[chunk][row - self.starts[chunk]]


def column_of(table: datasets.Dataset, key: str) -> Column | None:
    """A column of a table, if it holds nothing but numbers, as many in each row."""
    chunks, rows = [], [0]
    for chunk in table.data.column(key).chunks:
        values, shape = chunk, []
        if isinstance(values.type, pa.ExtensionType):
            shape, values = list(values.type.shape), values.storage
        while isinstance(values, pa.ListArray | pa.LargeListArray | pa.FixedSizeListArray):
            lengths = pc.call_function("list_value_length", [values]).unique().to_pylist()
            if len(lengths) > 1 or None in lengths:
                return None
            if not isinstance(chunk.type, pa.ExtensionType):
                shape += lengths or [0]
            values = values.flatten()
        kind = values.type
        if values.null_count or not (
            pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
        ):
            return None
        numbers = values.to_numpy(zero_copy_only=False)
        if None in shape or numbers.size != len(chunk) * int(np.prod(shape, dtype=int)):
            return None
        chunks.append(numbers.reshape(len(chunk), *shape))
        rows.append(len(chunk))
    if not chunks or len({chunk.shape[1:] for chunk in chunks if len(chunk)}) > 1:
        return None
    dtype = {"f": np.float32, "b": np.bool_}.get(chunks[0].dtype.kind, np.int64)
    return Column(chunks, np.cumsum(rows), dtype)
