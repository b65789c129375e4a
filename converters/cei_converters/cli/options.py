"""Values of command-line options that draccus has no type for."""

import re

import numpy as np

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


def parse_pose(option: str, text: str | None) -> np.ndarray | None:
    """`x,y,z` or `x,y,z,qw,qx,qy,qz` -> (4, 4) transform, metres; None stays None.

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
        raise CEIError(f"{option}={text} should read x,y,z or x,y,z,qw,qx,qy,qz (metres).") from error
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
