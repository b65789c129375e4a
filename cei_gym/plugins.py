"""What installed packages add by entry points, by group and name: `[project.entry-points."cei_gym.solvers"]` in a pyproject.toml.

Names are read from metadata, without importing anything; what they name is imported when it is asked for.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any

from cei_gym.errors import CEIError, one_line, unknown


@cache
def _every() -> EntryPoints:
    """Read the entry points of all groups, once: it takes 16 ms."""
    return entry_points()


def found(group: str) -> Sequence[EntryPoint]:
    """The entry points of a group, of all packages."""
    return tuple(_every().select(group=group))


@cache
def offered(group: str) -> dict[str, EntryPoint]:
    """The entry points of a group by name, in the order of names.

    Raises:
        CEIError: two packages offer different things under one name.
    """
    points: dict[str, EntryPoint] = {}
    for point in sorted(found(group), key=lambda each: each.name):
        other = points.setdefault(point.name, point)
        if other.value != point.value:
            raise CEIError(
                f"two packages offer {point.name!r} of {group}: {other.value} and {point.value}; uninstall one."
            )
    return points


def providers(group: str, names: Iterable[str]) -> dict[str, str]:
    """Name to version of the installed packages that offer these of a group, those that nobody offers left out."""
    points = offered(group)
    packages = [points[name].dist for name in names if name in points]
    return {package.name: package.version for package in packages if package is not None}


def load(group: str, name: str, kind: type, what: str) -> Any:
    """Import what a package offers.

    Args:
        group: the entry points'.
        name: of the one wanted.
        kind: what it is an instance of, or a subclass if it is a class.
        what: it is, in words, for messages.

    Raises:
        CEIError: nobody offers it, it cannot be imported, or it is something else.
    """
    points = offered(group)
    if name not in points:
        raise unknown(what, name, points)
    try:
        loaded = points[name].load()
    except Exception as error:  # a stranger's module may raise anything
        raise CEIError(f"{what} {name!r} cannot be imported from {points[name].value}: {one_line(error)}") from error
    if not (issubclass(loaded, kind) if isinstance(loaded, type) else isinstance(loaded, kind)):
        raise CEIError(f"{what} {name!r}, {points[name].value}, should be a {kind.__module__}.{kind.__qualname__}.")
    return loaded
