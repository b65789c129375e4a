"""A model as robosuite stores it with each episode, in MJCF: where its states have what. Parsed, never compiled: its meshes are a stranger's paths."""

from xml.etree.ElementTree import Element

import numpy as np

from cei_envs.tasks.cube import DENSITY_KG_M3
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted_xml import load_xml

_POSITIONS = {"free": 7, "ball": 4, "slide": 1, "hinge": 1}
_SPEEDS = {"free": 6, "ball": 3, "slide": 1, "hinge": 1}


class StoredModel:
    """What an MJCF says of bodies, joints and boxes, and where rows of states (time, positions, speeds) have a joint.

    Args:
        mjcf: the model's text.

    Raises:
        CEIError: it is no MJCF, or has a joint of no kind.
    """

    def __init__(self, mjcf: str) -> None:
        try:
            root = load_xml(mjcf.encode())
        except CEIError as error:
            raise CEIError(f"the stored model cannot be read: {error}") from error
        self._worlds = root.findall("worldbody")
        self._columns: dict[str, slice] = {}
        start = 1  # after the time
        speeds = 0
        for joint in (each for world in self._worlds for each in world.iter() if each.tag in ("joint", "freejoint")):
            kind = "free" if joint.tag == "freejoint" else joint.get("type", "hinge")
            if kind not in _POSITIONS:
                raise CEIError(f"the stored model has a joint of type {one_line(kind, 40)!r}.")
            self._columns[joint.get("name", "")] = slice(start, start + _POSITIONS[kind])
            start, speeds = start + _POSITIONS[kind], speeds + _SPEEDS[kind]
        self.width = start + speeds
        """Of a row of states."""

    def joint(self, name: str, states: Array) -> Array:
        """(T, k) positions of a joint in states (T, `width`), rad or m; of a free one place and quaternion w, x, y, z.

        Raises:
            CEIError: there is no such joint, or states are those of another model.
        """
        if states.ndim != 2 or states.shape[1] != self.width:
            raise CEIError(f"states have shape {states.shape}, but the stored model's have {self.width} columns.")
        if name not in self._columns:
            raise CEIError(f"the stored model has no joint {name}.")
        return states[:, self._columns[name]]

    def place(self, body: str) -> Array:
        """(7,) where a body that is fixed to the world is, m, and its quaternion w, x, y, z.

        Raises:
            CEIError: there is none.
        """
        for each in (each for world in self._worlds for each in world.findall("body")):
            if each.get("name") == body:
                return np.array([*_numbers(each, "pos", [0.0, 0, 0]), *_numbers(each, "quat", [1.0, 0, 0, 0])])
        raise CEIError(f"the stored model has no body {body} fixed to the world.")

    def box(self, geom: str) -> Array:
        """(4,) half sizes of a box, m, and its mass, kg.

        Raises:
            CEIError: there is none.
        """
        for each in (each for world in self._worlds for each in world.iter("geom")):
            if each.get("name") == geom and each.get("type") == "box":
                half = _numbers(each, "size", [0.0, 0, 0])
                (density,) = _numbers(each, "density", [DENSITY_KG_M3])
                (mass,) = _numbers(each, "mass", [density * 8 * np.prod(half)])
                return np.array([*half, mass])
        raise CEIError(f"the stored model has no box {geom}.")


def _numbers(element: Element, name: str, default: list[float]) -> Array:
    """An attribute that is so many finite numbers.

    Raises:
        CEIError: it is not.
    """
    text = element.get(name)
    if text is None:
        return np.array(default)
    try:
        found = np.array([float(each) for each in text.split()])
    except ValueError:
        found = np.empty(0)
    if len(found) != len(default) or not np.isfinite(found).all():
        raise CEIError(f"the stored model has {name}={one_line(text, 60)!r}; it should be {len(default)} numbers.")
    return found
