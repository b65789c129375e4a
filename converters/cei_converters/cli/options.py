"""Values of command-line options that draccus has no type for."""

import dataclasses
import re
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from cei_gym.arrays import Array
from cei_gym.errors import CEIError

_MOST_EPISODES = 10_000_000


def parse_episodes(text: str | None) -> list[int] | None:
    """`0,3,5`, `[0, 3]` or `0-99,120` -> indices; None stays None.

    Raises:
        CEIError: it is no list of indices.
    """
    if text is None:
        return None
    indices: list[int] = []
    try:
        for part in text.strip().removeprefix("[").removesuffix("]").split(","):
            span = re.fullmatch(r"\s*(\d+)\s*-\s*(\d+)\s*", part)
            first, last = (int(end) for end in (span.groups() if span else (part, part)))
            if not first <= last < first + _MOST_EPISODES:
                raise ValueError
            indices += range(first, last + 1)
    except ValueError as error:
        raise CEIError(
            f"--episodes={text} is no list of episode indices; it should read like 0,3,5 or 0-99."
        ) from error
    return indices


def parse_pose(option: str, text: str | None, instead: str = "") -> Array | None:
    """`x,y,z` or `x,y,z,qw,qx,qy,qz` -> (4, 4) transform, metres; None stays None. `instead` is what else the option takes, for the message.

    Raises:
        CEIError: it is no pose.
    """
    if text is None:
        return None
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    try:
        x, y, z, *quaternion_wxyz = (float(part) for part in text.strip().strip("[]").split(","))
        T[:3, 3] = x, y, z
        if quaternion_wxyz:
            T[:3, :3] = Rotation.from_quat(quaternion_wxyz, scalar_first=True).as_matrix()
    except ValueError as error:
        raise CEIError(
            f"{option}={text} should read x,y,z or x,y,z,qw,qx,qy,qz (metres){instead and f', or {instead}'}."
        ) from error
    return T


def parse_numbers(option: str, text: str, example: str) -> list[float]:
    """`0.2,0.2` or `[0.2, 0.2]` -> finite numbers, as many as the example has.

    Raises:
        CEIError: it reads otherwise.
    """
    try:
        numbers = [float(part) for part in text.strip().strip("[]").split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != len(example.split(",")) or not np.isfinite(numbers).all():
        raise CEIError(f"{option}={text} should read like {example}.")
    return numbers


def check_range(option: str, value: float | None, least: float, most: float = np.inf) -> None:
    """Check that a number is in a range; None is.

    Raises:
        CEIError: it is not.
    """
    if value is not None and not least <= value <= most:
        up_to = f" and at most {most:g}" if most < np.inf else ""
        raise CEIError(f"{option}={value} should be at least {least:g}{up_to}.")


def check_overwrite(overwrite: bool, *results: object) -> None:
    """Check that `--overwrite` has something to replace.

    Raises:
        CEIError: no file of results is asked for.
    """
    if overwrite and all(result is None for result in results):
        raise CEIError("--overwrite is of no use without a file of results, such as --json.")


def changed(options: Any, prefix: str = "") -> Iterator[str]:
    """Dotted names of options (a dataclass) that have not their default."""
    for field in dataclasses.fields(options):
        value, name = getattr(options, field.name), prefix + field.name
        if dataclasses.is_dataclass(value):
            yield from changed(value, f"{name}.")
        elif value != field.default:
            yield name


def check_of_use(options: Any, idle: Mapping[str, str]) -> None:
    """Check that no option is given that changes nothing.

    Args:
        options: a dataclass.
        idle: patterns of options that do not matter beside the others, and why, such as "without --x".

    Raises:
        CEIError: naming the option, and why it does not.
    """
    for name in changed(options):
        for pattern, why in idle.items():
            if fnmatchcase(name, pattern):
                raise CEIError(f"--{name} is of no use {why}; leave it out.")
