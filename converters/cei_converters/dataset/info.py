"""What `meta/info.json` and `meta/episodes` must say before LeRobot's code and ours take their word for it."""

import math
import string
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cei_converters.dataset import schema
from cei_gym.errors import CEIError, one_line

MAX_FPS = 1000.0
_SIZES = ("chunks_size", "data_files_size_in_mb", "video_files_size_in_mb")
_PATHS = {"data_path": {"chunk_index", "file_index"}, "video_path": {"video_key", "chunk_index", "file_index"}}
_EPISODE_NUMBERS = ("episode_index", "length", "data/chunk_index", "data/file_index")


def check_info(info: Mapping[str, Any], where: str) -> None:
    """Check the contents of a v3.0 dataset's `meta/info.json`.

    Args:
        info: the contents.
        where: the file, for messages.

    Raises:
        CEIError: naming the field.
    """
    fps, episodes = info.get("fps"), info.get("total_episodes")
    if not isinstance(fps, (int, float)) or isinstance(fps, bool) or not 0 < fps <= MAX_FPS:
        raise CEIError(f"{where}: fps is {one_line(fps, 60)}; it should be a number above 0 and at most {MAX_FPS:g}.")
    if type(episodes) is not int or episodes < 0:
        raise CEIError(f"{where}: total_episodes is {one_line(episodes, 60)}; it should be a whole number.")
    for field in _SIZES:
        if field in info and not (type(info[field]) in (int, float) and info[field] > 0):
            raise CEIError(f"{where}: {field} is {one_line(info[field], 60)}; it should be a number above 0.")
    for field, names in _PATHS.items():
        if field in info and not (info[field] is None and field == "video_path"):
            _check_path(info[field], names, f"{where}: {field}")
    features = info.get("features")
    if not isinstance(features, dict) or not features:
        raise CEIError(f"{where}: features should map the name of each to its dtype, shape and names.")
    for key, feature in features.items():
        _check_feature(feature, f"{where}: feature {key!r}")
    for key in (schema.STATE, schema.ACTION, *schema.STATES_OF_OBJECTS, schema.POINT_CLOUD):
        feature = features.get(key)
        if feature is None:
            continue
        if not feature["dtype"].startswith(("float", "int", "uint")):
            raise CEIError(f"{where}: {key} is stored as {feature['dtype']!r}; it should be float32.")
        if key == schema.POINT_CLOUD:
            schema.cloud_shape(feature, f"{where}: {key}")
        names = schema.feature_names(feature)
        if key in schema.STATES_OF_OBJECTS and names and [len(names)] != feature["shape"]:
            raise CEIError(f"{where}: {key} has shape {feature['shape']}; it should be as long as its names.")


def check_episodes(table: pa.Table, total: int, root: Path) -> None:
    """Check what is known of each episode.

    Args:
        table: of them, a row an episode.
        total: how many there should be.
        root: the dataset's folder.

    Raises:
        CEIError: naming the column.
    """
    where = f"{root}/meta/episodes"
    if table.num_rows != total:
        raise CEIError(f"{where} has {table.num_rows} episodes, but total_episodes in meta/info.json is {total}.")
    for name in (*_EPISODE_NUMBERS, "tasks"):
        if name not in table.column_names:
            raise CEIError(f"{where}: column {name} is missing; download or record the dataset again.")
    for name in _EPISODE_NUMBERS:
        column = table.column(name)
        if not pa.types.is_integer(column.type) or column.null_count:
            raise CEIError(f"{where}: {name} should be a whole number for each episode.")
    if table.column("episode_index").to_pylist() != list(range(total)):
        raise CEIError(f"{where}: episode_index should count from 0 to {total - 1}.")
    tasks = table.column("tasks")
    if tasks.type not in (pa.list_(pa.string()), pa.large_list(pa.large_string())) or tasks.null_count:
        raise CEIError(f"{where}: tasks should be a list of texts for each episode.")


def _check_path(path: object, names: set[str], where: str) -> None:
    """A template of a path inside the dataset, such as `data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet`."""
    try:
        parts = list(string.Formatter().parse(path)) if isinstance(path, str) else []
    except ValueError:
        parts = []
    plain = all(
        (name is None or name in names) and not conversion and (not spec or spec.rstrip("d") in ("02", "03", "06"))
        for _, name, spec, conversion in parts
    )
    if not parts or not plain or "\0" in str(path):
        raise CEIError(
            f"{where} is {one_line(path, 60)!r}; it should be a path with {', '.join(sorted(names))} in braces."
        )
    if Path(str(path)).is_absolute() or ".." in Path(str(path)).parts:
        raise CEIError(f"{where} {one_line(path, 60)!r} leads out of the dataset.")


def _check_feature(feature: object, where: str) -> None:
    if not isinstance(feature, dict) or not isinstance(feature.get("dtype"), str):
        raise CEIError(f"{where} should have a dtype, shape and names.")
    shape = feature.get("shape")
    if not isinstance(shape, list) or not all(type(side) is int and side > 0 for side in shape):
        raise CEIError(f"{where} has shape {one_line(shape, 60)}; it should be a list of whole numbers above 0.")
    if math.prod(shape) > np.iinfo(np.int32).max:
        raise CEIError(f"{where} has shape {one_line(shape, 60)}, which is too large.")
    for field in ("info", "video_info"):
        if not isinstance(feature.get(field) or {}, dict):
            raise CEIError(f"{where}: {field} should be a mapping, not {one_line(feature[field], 60)}.")
