"""YAML and JSON from strangers: no aliases that stand for a billion values, no key twice, no bottomless nesting, plain values only; and rows of numbers."""

import json
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import yaml

from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line

MAX_VALUES = 100_000
MAX_DIGITS = 300
"""Of a whole number: more would be no number of anything, and none that fits a float."""


def load_yaml(text: str, tags: Mapping[str, Callable[[str], Any]] | None = None) -> Any:
    """Plain values from YAML.

    Args:
        text: the YAML.
        tags: what makes a value of a scalar's text, by its own tag (`!degrees`).

    Raises:
        CEIError: it is no YAML, or has what is not allowed; without the file's name, which the caller knows.
    """
    return _load(lambda text: _parse_yaml(text, tags or {}), text)


def load_json(text: str) -> Any:
    """Plain values from JSON.

    Raises:
        CEIError: as `load_yaml`.
    """
    return _load(lambda text: json.loads(text, object_pairs_hook=_object, parse_int=_whole), text)


def finite_row(value: object, count: int) -> Array:
    """(count,) floats, of whatever is no text, truth or complex number.

    Raises:
        CEIError: it is something else; the message is what it is, to be put after "not".
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):  # of unequal lengths; a tensor that is elsewhere
        raise CEIError(f"a {type(value).__name__} that is no array") from None
    if array.dtype.kind not in "fiu" or array.shape != (count,):
        raise CEIError(f"{array.dtype} of shape {array.shape}")
    array = array.astype(float)
    if not np.isfinite(array).all():
        raise CEIError(f"{array[~np.isfinite(array)][0]} at {np.flatnonzero(~np.isfinite(array))[0]}")
    return array


def is_pose(T: Array) -> bool:
    """Whether an array is a rigid transform, [[R, t], [0, 0, 0, 1]]."""
    return bool(
        T.shape == (4, 4)
        and np.isfinite(T).all()
        and np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-4)
        and np.linalg.det(T[:3, :3]) > 0
        and np.allclose(T[3], (0, 0, 0, 1))
    )


def _load(parse: Callable[[str], Any], text: str) -> Any:
    try:
        return parse(text)
    except RecursionError:
        raise CEIError("its values are nested too deeply") from None
    except (yaml.YAMLError, ValueError) as error:
        raise CEIError(one_line(error)) from error


def _parse_yaml(text: str, tags: Mapping[str, Callable[[str], Any]]) -> Any:
    class Tagged(_Loader): ...

    for tag, read in tags.items():

        def construct(loader: _Loader, node: yaml.ScalarNode, read: Callable[[str], Any] = read) -> Any:
            return read(str(loader.construct_scalar(node)))

        Tagged.add_constructor(tag, construct)
    loader = Tagged(text)
    node = loader.get_single_node()
    if node is None:
        return None
    if _size(node, {}) > MAX_VALUES:
        raise CEIError(f"it stands for more than {MAX_VALUES} values; has it aliases (*name) of aliases?")
    return loader.construct_document(node)


def _size(node: yaml.Node, known: dict[yaml.Node, float]) -> float:
    """How many values a node stands for, aliases written out; infinitely many if it is part of itself."""
    if node not in known:
        known[node] = math.inf
        parts = node.value if isinstance(node, yaml.CollectionNode) else ()
        if isinstance(node, yaml.MappingNode):
            parts = [part for pair in node.value for part in pair]
        known[node] = 1 + sum(_size(part, known) for part in parts)
    return known[node]


class _Loader(yaml.SafeLoader):
    """YAML 1.2's core schema. Version 1.1, PyYAML's own, also reads `on` as true, `1:30` as 90, `010` as 8 and `2024-01-01` as a
    date, and has sets, dates and bytes by tag."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  (PyYAML's own name and type)
    yaml_constructors = {  # noqa: RUF012
        tag: construct
        for tag, construct in yaml.SafeLoader.yaml_constructors.items()
        if tag is None or tag.rpartition(":")[2] in ("null", "bool", "int", "float", "str", "seq", "map")
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        _refuse_repeated([key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)])
        return super().construct_mapping(node, deep)

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        text = str(self.construct_scalar(node))
        _refuse_long(text)
        if _LEADING_ZERO.fullmatch(text):  # 8 in YAML 1.1, 10 in YAML 1.2
            raise CEIError(f"{text} may be octal or decimal; write it without the zero, or as text in quotes")
        if node.tag.endswith(":int"):
            return int(text)
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))

    def construct_bool(self, node: yaml.ScalarNode) -> bool:
        text = str(self.construct_scalar(node)).lower()
        if text not in ("true", "false"):
            raise CEIError(f"{one_line(text, 30)!r} is neither true nor false")
        return text == "true"


_LEADING_ZERO = re.compile(r"[-+]?0[0-9]+")
_SIGNED = list("-+.0123456789")
for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+", _SIGNED),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", _SIGNED),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", _SIGNED),
    ("merge", r"<<", ["<"]),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _first)
for _tag in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _Loader.construct_number)
_Loader.add_constructor("tag:yaml.org,2002:bool", _Loader.construct_bool)


def _whole(text: str) -> int:
    _refuse_long(text)
    return int(text)


def _refuse_long(number: str) -> None:
    if len(number) > MAX_DIGITS:
        raise CEIError(f"{number[:20]!r}... has {len(number)} digits, more than any number here")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _refuse_repeated([key for key, _ in pairs])
    return dict(pairs)


def _refuse_repeated(keys: list[str]) -> None:
    seen: set[str] = set()
    for key in keys:
        if key in seen:
            raise CEIError(f"{one_line(key, 60)!r} is given twice")
        seen.add(key)
