"""Fields of a YAML that all have a value."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from math import isfinite
from typing import Any, cast

from cei_gym.errors import CEIError


class Checked:
    """Refuses a field without a value, YAML's null, and numbers that are not finite."""

    def __post_init__(self) -> None:
        for each in fields(self):  # pyright: ignore[reportArgumentType]  (all that derive from it are dataclasses)
            for value in _leaves(getattr(self, each.name)):
                if value is None or (isinstance(value, float) and not isfinite(value)):
                    raise CEIError(f"`{each.name}` has {value} where a value should be.")


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, (list, tuple, Mapping)):
        items = cast("Iterable[Any]", value.values() if isinstance(value, Mapping) else value)
        for item in items:
            yield from _leaves(item)
    else:
        yield value
