"""Channels: what a demonstration has of each of its frames, declared once.

A channel is a field of `Demonstration` with `metadata=channel(...)`. Its declaration says what its values are, and what becomes of them where the
demonstration goes to another embodiment or its objects are moved; whatever records, stores, reads, cuts or transfers demonstrations
goes by that, so that a channel which is declared is treated right everywhere.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from enum import StrEnum, auto
from functools import cache
from typing import Any, cast

import numpy as np

from cei_gym.arrays import Array
from cei_gym.errors import CEIError

_KEY = "channel"


class OnTransfer(StrEnum):
    """What becomes of a channel where a demonstration goes to another embodiment."""

    KEEP = auto()
    """It is of the world: the target's demonstration has it, frame by frame."""
    DROP = auto()
    """It is of the source's body, and nobody knows what the target's would be; that it is dropped is said."""
    RECOMPUTE = auto()
    """The transfer makes the target's own."""


class OnDisplacement(StrEnum):
    """What becomes of a channel where objects are moved (`cei_gym.augmentation`)."""

    AS_RECORDED = auto()
    """It stays, and `Demonstration.displacement` says how what it shows is moved."""
    MOVE = auto()
    """It says where objects are, and is moved with them."""
    DROP = auto()
    """It holds no more."""


@dataclass(frozen=True)
class Channel:
    """A declared channel.

    Attributes:
        shape: of a frame's values. A word stands for a size, the same wherever it is in a demonstration: "joints" of `qpos` and `action`.
        unit: of the values.
        on_transfer, on_displacement: see there.
        dtype: what is stored; values may be of any type of that kind.
        frame: of reference, where there is one.
        names: of the entries with their units, where they are always the same; else the demonstration has them in a field `<channel>_names`.
        finite: whether all values must be numbers.
        by_camera: a mapping of camera names to arrays instead of an array.
    """

    shape: tuple[int | str, ...]
    unit: str
    on_transfer: OnTransfer
    on_displacement: OnDisplacement
    dtype: str = "float32"
    frame: str = ""
    names: tuple[str, ...] = ()
    finite: bool = False
    by_camera: bool = False

    def arrays(self, value: Any) -> dict[str, Array]:
        """A channel's value as arrays (T, *shape), by camera; without cameras the one array is under the empty name, if there is one."""
        if self.by_camera:
            return dict(value)
        return {} if value is None else {"": value}

    def map(self, value: Any, change: Callable[[Array], Array]) -> Any:
        """A channel's value with a change made to each of its arrays."""
        changed = {name: change(array) for name, array in self.arrays(value).items()}
        return changed if self.by_camera else changed.get("")

    @property
    def nothing(self) -> Any:
        """The value of a demonstration that does not have this channel."""
        return {} if self.by_camera else None


def channel(*args: Any, **kwargs: Any) -> dict[str, Channel]:
    """`metadata` of a dataclass's field that is a channel, with the arguments of `Channel`."""
    return {_KEY: Channel(*args, **kwargs)}


@cache
def channels(kind: type[Any]) -> Mapping[str, Channel]:
    """The channels that a dataclass declares, by name, in their order."""
    return {each.name: each.metadata[_KEY] for each in fields(kind) if _KEY in each.metadata}


def _of(owner: Any) -> Mapping[str, Channel]:
    return channels(cast(type[Any], type(owner)))


def present(owner: Any) -> Iterator[tuple[str, Channel, Any]]:
    """Name, declaration and value of each channel that a demonstration has."""
    for name, declared in _of(owner).items():
        if declared.arrays(value := getattr(owner, name)):
            yield name, declared, value


def entry_names(owner: Any, name: str) -> tuple[str, ...]:
    """Names of a channel's entries, with units; none where nobody knows them."""
    return _of(owner)[name].names or getattr(owner, f"{name}_names", ())


def check_channels(owner: Any, frames: int, where: str) -> None:
    """Check that channels are as they are declared, and have a row for each frame.

    Args:
        owner: of a class with channels.
        frames: how many rows each has.
        where: for messages.

    Raises:
        CEIError: one is not; the message names the channel, its shape and the right one.
    """
    sizes: dict[str, int] = {}
    for name, declared, value in present(owner):
        for camera, array in declared.arrays(value).items():
            of = f"{where}: {name}" + f" of camera {camera}" * bool(camera)
            _check_shape(array, frames, declared, of, {} if declared.by_camera else sizes)
            if declared.finite and len(bad := np.argwhere(~np.isfinite(array))):
                raise CEIError(f"{of} is not finite at frame {bad[0][0]}, entry {', '.join(map(str, bad[0][1:]))}.")
        names = entry_names(owner, name)
        if names and len(names) != value.shape[-1]:
            raise CEIError(f"{where}: {name} has {value.shape[-1]} entries and {len(names)} names.")


def _check_shape(array: Array, frames: int, declared: Channel, of: str, sizes: dict[str, int]) -> None:
    right = [
        sizes.setdefault(side, size) if isinstance(side, str) else side
        for side, size in zip(declared.shape, array.shape[1:], strict=False)
    ]
    if array.shape != (frames, *right) or len(right) != len(declared.shape):
        raise CEIError(
            f"{of} has shape {array.shape}; it should be ({', '.join(map(str, (frames, *_told(declared, sizes))))}), a row for each frame."
        )
    if (array.dtype.kind == "f") != declared.dtype.startswith("float"):
        raise CEIError(f"{of} is of {array.dtype}; it should be of {declared.dtype}.")


def _told(declared: Channel, sizes: Mapping[str, int]) -> list[int | str]:
    return [sizes.get(side, side) if isinstance(side, str) else side for side in declared.shape]
