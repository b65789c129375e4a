"""A dataset's columns as they are recorded, before anybody says which joints they are."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cei_converters import schema
from cei_gym.errors import CEIError


@dataclass(frozen=True)
class Recording:
    """One episode.

    Attributes:
        state: (T, k).
        action: (T, k) of the same columns, or None where actions are something else.
        times_s: (T,) when, or None.
    """

    state: np.ndarray
    action: np.ndarray | None = None
    times_s: np.ndarray | None = None


@dataclass(frozen=True)
class Recordings:
    """Some episodes of a dataset.

    Attributes:
        names: k columns.
        fps: as declared, or None.
        episodes: those that were read.
        total: how many there are.
    """

    names: list[str]
    fps: float | None
    episodes: list[Recording]
    total: int


def read_recordings(
    repo_id: str, root: str | Path | None, most: int, state: str = schema.STATE, action: str | None = schema.ACTION
) -> Recordings:
    """Columns of some episodes, spread over the dataset; of LeRobot's formats, HDF5 or zarr.

    Args:
        repo_id, root: see `open_source`.
        most: how many episodes to read.
        state, action: LeRobot's features to look at.

    Raises:
        CEIError: it cannot be read.
    """
    if root is not None and Path(root).suffix in (".hdf5", ".h5"):
        from cei_converters.robomimic import record

        return record(Path(root), most)
    if root is not None and any(Path(root, mark).is_file() for mark in (".zgroup", "zarr.json")):
        from cei_converters.zarr_source import record

        return record(Path(root), most)
    return _record_lerobot(repo_id, root, most, state, action)


def spread(total: int, most: int) -> list[int]:
    """At most so many of `range(total)`, far apart."""
    return sorted({round(i) for i in np.linspace(0, total - 1, most)})


def _record_lerobot(repo_id: str, root: str | Path | None, most: int, state: str, action: str | None) -> Recordings:
    from cei_converters.columns import decode_array, read_columns
    from cei_converters.locate import locate
    from cei_converters.opening import load_lerobot_metadata

    folder = locate(repo_id, root)
    meta = load_lerobot_metadata(repo_id, folder)
    for key in filter(None, (state, action)):
        if key not in meta.features:
            raise CEIError(f"{folder.name} has no feature {key!r}. It has: {', '.join(meta.features)}.")
    shape = tuple(meta.features[state]["shape"])
    if len(shape) != 1:
        raise CEIError(f"{state} should be one row of numbers a frame, not {shape}.")
    same = action is not None and tuple(meta.features[action]["shape"]) == shape

    def episodes() -> Iterator[Recording]:
        for index in spread(meta.total_episodes, most):
            table = read_columns(folder, meta, index, [state, *([action] if action else []), "timestamp"])
            found = {
                key: decode_array(table[key], meta.features[key], f"episode {index}, {key}").astype(float)
                for key in table.column_names
            }
            times_s = found["timestamp"].ravel() if "timestamp" in found else None
            yield Recording(found[state], found[action] if same and action else None, times_s)

    names = schema.feature_names(meta.features[state])
    if len(names) != shape[0]:
        names = [str(i) for i in range(shape[0])]
    return Recordings(names, float(meta.fps), list(episodes()), meta.total_episodes)
