"""Values of options, from the text of a command line: what a name or a path contains never means anything."""

import json
import math
import os
import types
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cei_gym.errors import CEIError, one_line

_LARGEST = 2**63


def read_value(option: str, text: str, hint: Any) -> Any:
    """The value that a text stands for.

    Args:
        option: with its hyphens, for messages.
        text: what is given. Of a name (str) or a path it is taken as it is; numbers are decimal; a list reads `a,b`, or `a:b` if it is of
            paths, in brackets or not, or is JSON, `["a", "b"]`; null is None where a number or a list may be missing.
        hint: type of the option.

    Raises:
        CEIError: it is no such value.
    """
    hint, optional = _without_none(hint)
    if not text:
        raise CEIError(f"{option}= is empty; give it a value, or leave it out.")
    if hint in (str, Path):
        return text
    if optional and text == "null":
        return None
    if hint in _READERS:
        read, wanted = _READERS[hint]
        try:
            return read(text)
        except ValueError:
            raise CEIError(f"{option}={one_line(text, 60)} should be {wanted}.") from None
    if typing.get_origin(hint) in (list, tuple):
        item_hint = typing.get_args(hint)[0]
        items = _items(text, os.pathsep if item_hint is Path else ",")
        return [read_value(option, item, item_hint) for item in items]
    raise TypeError(f"{option}: options of type {hint} cannot be read from a command line")


def is_path(hint: Any) -> bool:
    """Whether an option of this type is a path, or a list of them."""
    hint, _ = _without_none(hint)
    return hint is Path or (typing.get_origin(hint) in (list, tuple) and typing.get_args(hint)[0] is Path)


def is_optional(hint: Any) -> bool:
    """Whether an option of this type may be None."""
    return _without_none(hint)[1]


def home_expanded(option: str, path: str) -> str:
    """A path whose leading ~ is a home folder's.

    Raises:
        CEIError: it has no such user, or is no path.
    """
    if "\0" in path:
        raise CEIError(f"{option}: a path has no null character.")
    try:
        return str(Path(path).expanduser())
    except RuntimeError:
        raise CEIError(f"{option}={path}: there is no such user; a file called ~ is ./~.") from None


def _without_none(hint: Any) -> tuple[Any, bool]:
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        kinds = [kind for kind in typing.get_args(hint) if kind is not type(None)]
        if len(kinds) == 1:
            return kinds[0], len(typing.get_args(hint)) > 1
    return hint, False


def _items(text: str, separator: str) -> list[str]:
    if text.startswith("["):
        try:
            found = json.loads(text)
        except ValueError:
            text = text.removeprefix("[").removesuffix("]")
        else:
            return [item if isinstance(item, str) else json.dumps(item) for item in found]
    return [item.strip() for item in text.split(separator)]


def _boolean(text: str) -> bool:
    if text not in ("true", "false"):
        raise ValueError
    return text == "true"


def _integer(text: str) -> int:
    value = int(text)
    if not -_LARGEST <= value < _LARGEST:
        raise ValueError
    return value


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


_READERS: dict[Any, tuple[Callable[[str], Any], str]] = {
    bool: (_boolean, "true or false"),
    int: (_integer, "a whole number, of 64 bits at most"),
    float: (_number, "a finite number"),
}
