"""Points of a robot that somebody clicked in a camera's pictures, from a YAML file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import finite_row, load_yaml

FORMAT = """clicks (four or more; a point is a link, by its frame's origin, or x, y, z in m in a link's frame):
  - {episode: 0, frame: 12, point: link5, pixel: [212, 140]}
  - {episode: 0, frame: 12, point: {link: link7, xyz: [0.0, 0.0, 0.1]}, pixel: [250.5, 171]}"""
_FIELDS = ("episode", "frame", "point", "pixel")
_MOST = 1000


@dataclass(frozen=True)
class Click:
    """A point of a robot in one picture.

    Attributes:
        episode, frame: which picture.
        body: the link's index in the robots' models, one after the other.
        xyz_link: (3,) the point in its frame, m.
        pixel: (2,) column and row.
    """

    episode: int
    frame: int
    body: int
    xyz_link: Array
    pixel: Array


def load_clicks(path: Path, robots: Sequence[Embodiment], width: int, height: int) -> list[Click]:
    """Read and check a file of clicks in pictures of a size; see `FORMAT`. A link is the first robot's that has it.

    Raises:
        CEIError: naming the file, the click and the field.
    """
    try:
        raw = load_yaml(path.read_text())
    except (OSError, ValueError) as error:
        raise CEIError(f"clicks {path} cannot be read: {one_line(error)}.") from error
    if not isinstance(raw, list) or not 4 <= len(raw) <= _MOST:
        raise CEIError(f"{path.name} should be a list of 4 to {_MOST} clicks, each with {', '.join(_FIELDS)}.")
    return [_click(each, f"{path.name}: click {i + 1}", robots, width, height) for i, each in enumerate(raw)]


def _click(raw: Any, where: str, robots: Sequence[Embodiment], width: int, height: int) -> Click:
    if not isinstance(raw, dict) or set(raw) != set(_FIELDS):
        raise CEIError(f"{where} should have {', '.join(_FIELDS)}, and nothing else.")
    for name in ("episode", "frame"):
        if type(raw[name]) is not int or raw[name] < 0:
            raise CEIError(f"{where}: {name} should be a whole number from 0, not {one_line(repr(raw[name]), 60)}.")
    point = raw["point"] if isinstance(raw["point"], dict) else {"link": raw["point"], "xyz": [0, 0, 0]}
    if set(point) != {"link", "xyz"} or not isinstance(point["link"], str):
        raise CEIError(f"{where}: point should be a link's name, or link and xyz (m, in its frame).")
    body = _body(point["link"], robots, where)
    pixel = _row(raw["pixel"], 2, f"{where}: pixel")
    if not (-0.5 <= pixel[0] <= width - 0.5 and -0.5 <= pixel[1] <= height - 0.5):
        raise CEIError(f"{where}: pixel {pixel.tolist()} is outside pictures of {width}x{height}.")
    return Click(raw["episode"], raw["frame"], body, _row(point["xyz"], 3, f"{where}: xyz"), pixel)


def _body(link: str, robots: Sequence[Embodiment], where: str) -> int:
    first, refused = 0, ""
    for robot in robots:
        try:
            return first + robot.body_id(link)
        except CEIError as error:
            first, refused = first + robot.model.nbody, refused or str(error)
    raise CEIError(f"{where}: {refused}")


def _row(value: object, count: int, where: str) -> Array:
    try:
        return finite_row(value, count)
    except CEIError as error:
        raise CEIError(f"{where} should be {count} numbers, not {error}.") from None
