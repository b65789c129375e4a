"""YAML and JSON from strangers: no aliases, which can stand for any amount of memory, no key twice, no bottomless nesting."""

import json
from collections.abc import Callable
from typing import Any

import yaml

from cei_gym.errors import CEIError, one_line


def load_yaml(text: str) -> Any:
    """Plain values from YAML.

    Raises:
        CEIError: it is no YAML, or has what is not allowed; without the file's name, which the caller knows.
    """
    return _load(lambda text: yaml.load(text, _Loader), text)


def load_json(text: str) -> Any:
    """Plain values from JSON.

    Raises:
        CEIError: as `load_yaml`.
    """
    return _load(lambda text: json.loads(text, object_pairs_hook=_object), text)


def _load(parse: Callable[[str], Any], text: str) -> Any:
    try:
        return parse(text)
    except RecursionError:
        raise CEIError("its values are nested too deeply") from None
    except (yaml.YAMLError, ValueError) as error:
        raise CEIError(one_line(error)) from error


class _Loader(yaml.SafeLoader):
    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise CEIError("YAML aliases (*name) are not allowed")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        _refuse_repeated([key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)])
        return super().construct_mapping(node, deep)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _refuse_repeated([key for key, _ in pairs])
    return dict(pairs)


def _refuse_repeated(keys: list[str]) -> None:
    seen: set[str] = set()
    for key in keys:
        if key in seen:
            raise CEIError(f"{one_line(key, 60)!r} is given twice")
        seen.add(key)
