"""Which episode it is, wherever in a dataset it stands and whatever tool has put it there: a digest of its joints."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from cei_converters.dataset import schema
from cei_converters.dataset.columns import decode_array, read_columns
from cei_converters.dataset.description import Description

KEYS = (schema.STATE, schema.ACTION)
"""Features that tell episodes apart."""


def digests(root: Path, meta: Description, keys: Sequence[str] = KEYS) -> list[str]:
    """The identities of all episodes of a dataset.

    Args:
        root: its folder.
        meta: what it says of itself.
        keys: features to look at.

    Raises:
        CEIError: an episode cannot be read.
    """
    return [
        digest(read_columns(root, meta, index, keys), meta.features, f"episode {index}", keys)
        for index in range(meta.total_episodes)
    ]


def digest(rows: pa.Table, features: Mapping[str, dict[str, Any]], where: str, keys: Iterable[str] = KEYS) -> str:
    """16 hexadecimal digits of an episode's joints, as float32, in whatever type columns store them.

    Args:
        rows: of the episode.
        features: LeRobot's description of the columns.
        where: the episode, for messages.
        keys: features to look at.

    Raises:
        CEIError: a column holds something else.
    """
    found = hashlib.sha256()
    for key in keys:
        found.update(decode_array(rows[key], features[key], f"{where}, {key}").astype("<f4").tobytes())
    return found.hexdigest()[:16]
