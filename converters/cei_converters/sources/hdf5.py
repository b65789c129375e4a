"""HDF5 from strangers: only what is in the file itself, of a bounded size, and one line for whatever else is wrong."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_json

_MOST_BYTES = 2**32
"""Of one dataset: a file of a few kilobytes may say that it holds petabytes."""


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """A file, for reading.

    Raises:
        CEIError: it is no HDF5, or what is read in the block is damaged.
    """
    try:
        with h5py.File(path, "r") as file:
            yield file
    except CEIError:
        raise
    except (
        OSError,
        KeyError,
        ValueError,
        TypeError,
        RuntimeError,
        OverflowError,
        MemoryError,
        AttributeError,
    ) as error:
        raise CEIError(f"{path} cannot be read as HDF5 ({one_line(error)}).") from error


def group_at(parent: h5py.Group, name: str, path: Path) -> h5py.Group | None:
    """A group in a group; None if there is none of that name.

    Raises:
        CEIError: it is a link.
    """
    _refuse_link(parent, name, path)
    found = parent.get(name)
    return found if isinstance(found, h5py.Group) else None


def groups_in(group: h5py.Group) -> list[str]:
    """Names of all that is in a group but datasets; links among them, which nothing here follows."""
    return [name for name in map(str, group) if not _is_dataset(group, name)]


def _is_dataset(group: h5py.Group, name: str) -> bool:
    own = isinstance(group.get(name, getlink=True), h5py.HardLink)  # asked for its kind, a link would be followed
    return own and group.get(name, getclass=True) is h5py.Dataset


def datasets_in(group: h5py.Group, path: Path) -> tuple[dict[str, h5py.Dataset], dict[str, str]]:
    """Datasets of a group that are in the file itself, and why others are not taken."""
    inside: dict[str, h5py.Dataset] = {}
    outside: dict[str, str] = {}
    for name in map(str, group):
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            outside[name] = "a link, which is not followed"
        elif isinstance(data := group[name], h5py.Dataset):
            if reason := _stored_elsewhere(data):
                outside[name] = reason
            else:
                inside[name] = data
    return inside, outside


def dataset_at(group: h5py.Group, name: str, path: Path) -> h5py.Dataset | None:
    """A dataset in a group; None if there is none of that name.

    Raises:
        CEIError: it is a link, or its values are in another file.
    """
    _refuse_link(group, name, path)
    found = group.get(name)
    if not isinstance(found, h5py.Dataset):
        return None
    if reason := _stored_elsewhere(found):
        raise CEIError(f"{path}: {_name(found)} is {reason}; write its values into the file.")
    return found


def read(data: h5py.Dataset, path: Path) -> Array:
    """All values of a dataset of numbers.

    Raises:
        CEIError: they are no numbers, or far too many.
    """
    if data.dtype.kind not in "fiub":
        raise CEIError(f"{path}: {_name(data)} is stored as {one_line(data.dtype, 60)}; it should be numbers.")
    if not isinstance(data.shape, tuple) or data.size * data.dtype.itemsize > _MOST_BYTES:
        raise CEIError(
            f"{path}: {_name(data)} says that it has shape {one_line(data.shape, 60)}, which is too large for an episode."
        )
    return np.asarray(data[()])


def json_attribute(holder: Any, name: str) -> dict[str, Any]:
    """An attribute that is a JSON object; empty if it is none, or not there."""
    try:
        text = holder.attrs.get(name)
        found = load_json(text.decode() if isinstance(text, bytes) else text) if isinstance(text, (str, bytes)) else {}
    except (ValueError, OSError, TypeError, KeyError, RuntimeError):  # CEIError and UnicodeDecodeError, too
        return {}
    return found if isinstance(found, dict) else {}


def _refuse_link(parent: h5py.Group, name: str, path: Path) -> None:
    link = parent.get(name, getlink=True)
    if isinstance(link, (h5py.SoftLink, h5py.ExternalLink)):
        to = f"{link.filename}:{link.path}" if isinstance(link, h5py.ExternalLink) else link.path
        raise CEIError(
            f"{path}: {_name(parent).rstrip('/')}/{name} is a link to {one_line(to, 60)}; links are not followed: copy into the file what "
            "it leads to (h5copy, h5repack --merge)."
        )


def _stored_elsewhere(data: h5py.Dataset) -> str:
    if data.external:
        return "stored in another file"
    return "put together from other datasets (virtual)" if data.is_virtual else ""


def _name(found: h5py.HLObject) -> str:
    return one_line(found.name or "a dataset", 80)
