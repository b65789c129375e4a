"""Where a dataset's demonstrations start, from their first frames: a policy knows no other way."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from cei_converters.dataset import schema
from cei_converters.dataset.hidden import visible
from cei_converters.dataset.metadata import restore_with
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line

SAME_RAD = 0.45
"""Starts whose joints differ by less, rad or m, are of one motion: hands of two motions of a conversion are 60 degrees or 10 cm apart (`init.modes`)."""
_FRAME = "frame_index"


def middle(starts: Sequence[Sequence[float]] | Array) -> list[float]:
    """Choose what environments start at from the starts (k, n) of one motion."""
    return np.round(np.median(starts, axis=0), 4).tolist()


def find_starts(root: Path) -> list[list[float]]:
    """The middle start of each motion that a dataset's episodes are of: two that reach the object differently have no middle.

    Args:
        root: its folder.

    Raises:
        CEIError: it has no joint positions, or they cannot be read.
    """
    motions: list[list[Array]] = []
    for start in _first_states(root):  # by their first: all pairs of ten thousand would take a gigabyte
        near = (motion for motion in motions if np.abs(motion[0] - start).max() < SAME_RAD)
        found = next(near, None)
        if found is None:
            motions.append(found := [])
        found.append(start)
    return [middle(np.array(motion)) for motion in motions]


def _first_states(root: Path) -> Array:
    """(episodes, n) joint positions of each episode's first frame, as they are stored."""
    found = []
    try:
        for path in visible(root, "data/*/*.parquet"):
            with pq.ParquetFile(path) as file:
                for batch in file.iter_batches(columns=[schema.STATE, _FRAME]):
                    first = pa.Table.from_batches([batch]).filter(pc.field(_FRAME) == 0)
                    found += [np.asarray(state, np.float64) for state in first[schema.STATE].to_pylist()]
        return np.stack(found)
    except (OSError, KeyError, TypeError, ValueError, pa.ArrowException) as error:
        raise CEIError(
            f"{root} does not say where its demonstrations start: {schema.STATE} of their first frames cannot be read "
            f"({one_line(error)}). {restore_with(root)}"
        ) from error
