"""Point clouds as datasets have them: (N, 3 or 6) a frame, or flat, as LeRobot's tools for datasets want it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

CHANNELS = (3, 6)
Bounds = tuple[tuple[float, ...], tuple[float, ...]]
"""Least and largest value of each channel."""


def layout_of(feature: Mapping[str, Any]) -> tuple[int, int] | None:
    """Points and channels of a dataset's feature: its shape, or that of its `info` where it is flat; None if it says neither."""
    shape = [*feature["shape"]]
    if len(shape) == 1:
        shape = (feature.get("info") or {}).get("shape")
    if not isinstance(shape, list) or len(shape) != 2 or shape[1] not in CHANNELS:
        return None
    return (shape[0], shape[1]) if np.prod(shape) == np.prod(feature["shape"]) else None


def bounds_of(key: str, channels: int, stats: Mapping[str, Any] | None, root: Path | None) -> Bounds | None:
    """Bounds of a dataset's clouds: from its statistics, else from its tables; None where there is neither.

    Args:
        key: their feature.
        channels: a point's.
        stats: of the dataset; those of a flat feature are of each of its entries.
        root: the dataset's folder.
    """
    known = (stats or {}).get(key)
    if known is not None:
        ends = (
            np.asarray(known["min"]).reshape(-1, channels).min(0),
            np.asarray(known["max"]).reshape(-1, channels).max(0),
        )
    else:
        found = (
            []
            if root is None
            else [ends for path in sorted(root.glob("data/*/[!.]*.parquet")) for ends in _ends(path, key)]
        )
        if not found:
            return None
        low, high = np.stack(found, axis=1)
        ends = low.min(0).reshape(-1, channels).min(0), high.max(0).reshape(-1, channels).max(0)
    low, high = (tuple(map(float, end)) for end in ends)
    return low, high


def _ends(path: Path, key: str):
    """Least and largest of each entry, for some rows of a file at a time."""
    with pq.ParquetFile(path) as file:
        for batch in file.iter_batches(batch_size=256, columns=[key]):
            values, rows = batch.column(0), batch.num_rows
            while isinstance(values, pa.ListArray | pa.LargeListArray | pa.FixedSizeListArray):
                values = values.flatten()
            numbers = values.to_numpy(zero_copy_only=False).reshape(rows, -1)
            yield numbers.min(axis=0), numbers.max(axis=0)
