"""Values of features as they are stored: depth in whole millimetres, everything else in float32."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cei_converters.dataset import schema
from cei_converters.dataset.depth import MM_PER_M
from cei_converters.dataset.description import Description
from cei_converters.dataset.rows import read_rows
from cei_gym.arrays import Array
from cei_gym.channels import Channel, present
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError, one_line

MAX_DEPTH_MM = np.iinfo(np.uint16).max


def encode(demonstration: Demonstration, state_key: str = schema.PRIVILEGED_STATE) -> dict[str, Array]:
    """Feature key to (T, ...) values in the stored type and unit; the state of objects goes under `state_key`."""
    return {
        schema.channel_key(name, camera, state_key): _stored(name, declared, array)
        for name, declared, value in present(demonstration)
        for camera, array in declared.arrays(value).items()
    }


def _stored(name: str, declared: Channel, array: Array) -> Array:
    if name == "depth_m":
        return _depth_to_mm(array)
    stored = array.astype(declared.dtype)
    return stored.reshape(len(stored), -1) if name == "point_cloud_world" else stored


def _depth_to_mm(depth_m: Array) -> Array:
    """(..., H, W) float metres -> (..., H, W, 1) uint16 millimetres; 0 stays "unknown".

    Raises:
        CEIError: a depth is negative, not finite, or beyond 65.535 m.
    """
    depth_mm = np.rint(depth_m * MM_PER_M)
    if not (np.isfinite(depth_mm).all() and depth_mm.min() >= 0 and depth_mm.max() <= MAX_DEPTH_MM):
        raise CEIError(
            f"depth must be finite and within [0, {MAX_DEPTH_MM / MM_PER_M}] m, 0 where unknown; "
            f"got {np.min(depth_m)} to {np.max(depth_m)}."
        )
    return depth_mm.astype(np.uint16)[..., None]


def decode_array(column: Any, feature: Mapping[str, Any], where: str, boolean: bool = False) -> Array:
    """A list column as an array (T, *shape).

    Args:
        column: Arrow's.
        feature: LeRobot's description of it.
        where: for messages.
        boolean: whether yes and no are allowed, too.

    Raises:
        CEIError: the column's rows are no numbers, or not of the feature's shape.
    """
    array = column.combine_chunks()
    array = getattr(array, "storage", array)  # datasets keeps 2-D features in an extension type
    while isinstance(array, (pa.ListArray, pa.LargeListArray, pa.FixedSizeListArray)) and not pa.types.is_map(
        array.type
    ):
        lengths = [] if isinstance(array, pa.FixedSizeListArray) else array.value_lengths().unique()
        if array.null_count or len(lengths) > 1:  # rows of different lengths may have the right number of values in all
            raise CEIError(f"{where}: a row is not of shape {tuple(feature['shape'])}.")
        array = array.flatten()
    allowed = pa.types.is_floating(array.type) or pa.types.is_integer(array.type)
    if not allowed and not (boolean and pa.types.is_boolean(array.type)):
        raise CEIError(f"{where} is stored as {one_line(column.type, 60)}; it should be numbers.")
    try:
        return array.to_numpy(zero_copy_only=False).reshape(len(column), *feature["shape"])
    except ValueError as error:
        raise CEIError(f"{where}: a row is not of shape {tuple(feature['shape'])}.") from error


def read_columns(root: Path, meta: Description, index: int, keys: Sequence[str]) -> pa.Table:
    """An episode's rows of those features that are in the dataset's tables.

    Args:
        root: the dataset's folder.
        meta: what it says of itself.
        index: the episode.
        keys: features; those that the dataset lacks or has as video are left out.

    Raises:
        CEIError: the file cannot be read, or has fewer or more of the episode's frames than there should be.
    """
    path = root / meta.data_file(index)
    columns = [key for key in keys if key in meta.features and key not in meta.video_keys]
    try:
        table = read_rows(path, index, columns)
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        raise CEIError(
            f"episode {index}: {path} cannot be read ({one_line(error)}); download or record the dataset again."
        ) from error
    missing = [key for key in columns if key not in table.column_names]
    if missing:
        raise CEIError(f"episode {index}: {path} has no column {missing[0]!r}; download or record the dataset again.")
    length = meta.episode(index)["length"]
    if table.num_rows not in (0, length):
        raise CEIError(
            f"episode {index}: {path} has {table.num_rows} of its frames, where meta/episodes says {length}; "
            "download or record the dataset again."
        )
    return table
