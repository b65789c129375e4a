"""The `pads:` block of an end-effector's YAML written anew in its text; all else stays byte for byte, comments too.

No library here keeps comments, so lines are replaced by the marks that PyYAML's nodes carry.
"""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, cast

import yaml

from cei_gym.embodiment import Pad
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_yaml

type Sourced = tuple[int | None, Pad]
"""A pad, and which of the text's pads it was; None for a new one."""


def replace_pads(text: str, pads: Sequence[Sourced]) -> str:
    """The text of an end-effector's YAML with other pads.

    A pad that is as it was keeps its lines, one that was changed the comments around it.

    Args:
        text: of the file, its line ends as they are.
        pads: those that it shall have, in their order, each with the index of the text's pad that it was.

    Raises:
        CEIError: it is no YAML with a `pads` of its own, or what is written would not read as these pads.
    """
    values = load_yaml(text)  # which bounds it, before it is read again
    root = cast(yaml.Node | None, cast(Any, yaml).compose(text, Loader=yaml.SafeLoader))
    pairs = cast(list[tuple[yaml.Node, yaml.Node]], root.value) if isinstance(root, yaml.MappingNode) else []
    found = next(((key, node) for key, node in pairs if key.value == "pads"), None)
    if found is None:
        raise CEIError("the YAML has no `pads` of its own to write to; add a line `pads: []`.")
    key, node = found
    if node.start_mark.index < key.end_mark.index:
        raise CEIError("the YAML's `pads` is an alias (*name); write them out, to edit them.")
    new = _by_lines(text, key, node, values["pads"], pads) or _at_once(text, key, node, pads)
    _check(values, new, pads)
    return new


def _by_lines(text: str, key: yaml.Node, node: yaml.Node, old: list[Any], pads: Sequence[Sourced]) -> str | None:
    """The text, if its pads are a list with lines of its own for each; else None."""
    items = cast(list[yaml.Node], node.value) if isinstance(node, yaml.SequenceNode) and not node.flow_style else []
    starts = [item.start_mark.index for item in items]
    ends = [_next_line(text, key.end_mark.index), *(_next_line(text, _end(item)) for item in items)]
    if not pads or not items or not all(end <= start for end, start in zip(ends, starts, strict=False)):
        return None  # an alias of what stands elsewhere, or two on a line
    dash, line_end = text.rindex("-", 0, starts[0]), _line_end(text)
    indent, block = " " * (dash - text.rfind("\n", 0, dash) - 1), ""
    for source, pad in pads:
        if source is None:
            block += f"{indent}- {_text_of(pad)}{line_end}"
            continue
        lines = text[ends[source] : ends[source + 1]]
        if _values(old[source]) != _values(pad):
            start, end = starts[source] - ends[source], _end(items[source]) - ends[source]
            lines = lines[:start] + _text_of(pad) + lines[end:]
        block += lines if lines.endswith("\n") else f"{lines}{line_end}"
    if ends[-1] == len(text) and not text.endswith("\n"):
        block = block.removesuffix(line_end)
    return text[: ends[0]] + block + text[ends[-1] :]


def _at_once(text: str, key: yaml.Node, node: yaml.Node, pads: Sequence[Sourced]) -> str:
    """The text with all of its pads replaced: after their key, and the comments beside it, comes a line for each."""
    end, line_end = _end(node), _line_end(text)
    after = text[end : _next_line(text, end)].rstrip("\r\n")
    comments = [_comment(text[key.end_mark.index : node.start_mark.index]), _comment(after)]
    said = "".join(f" {comment}" for comment in comments if comment)
    rest = text[end + len(after) :]
    if not pads:
        return f"{text[: key.end_mark.index]}: []{said}{rest}"
    indent = " " * (key.start_mark.column + 2)
    lines = "".join(f"{line_end}{indent}- {_text_of(pad)}" for _, pad in pads)
    return f"{text[: key.end_mark.index]}:{said}{lines}{rest}"


def _comment(text: str) -> str:
    _, mark, comment = text.partition("#")
    return f"{mark}{comment}".rstrip()


def _line_end(text: str) -> str:
    return "\r\n" if "\r\n" in text else "\n"


def _end(node: yaml.Node) -> int:
    """Where a node's text ends; that of a block, whose own mark is where the next one begins, with its last value."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = cast(yaml.Node | tuple[yaml.Node, yaml.Node], node.value[-1])
        return _end(last[1] if isinstance(last, tuple) else last)
    return cast(int, node.end_mark.index)


def _next_line(text: str, index: int) -> int:
    """Where the next line begins."""
    if index and text[index - 1] == "\n":
        return index
    return end + 1 if (end := text.find("\n", index)) >= 0 else len(text)


def _values(pad: Any) -> dict[str, Any]:
    """What a pad says by field, or one that is read from YAML, with what it leaves out."""
    pad = pad if isinstance(pad, Pad) else Pad(**pad)
    return {each.name: getattr(pad, each.name) for each in fields(pad)}


def _text_of(pad: Pad) -> str:
    """A pad on one line, without what is as by default."""
    default = _values(Pad(pad.body))
    said = {name: _plain(value) for name, value in _values(pad).items() if name == "body" or value != default[name]}
    return yaml.dump(said, Dumper=_Dumper, default_flow_style=True, sort_keys=False, width=10_000).strip()


def _plain(value: Any) -> Any:
    """Numbers as one writes them: 2 rather than 2.0."""
    if isinstance(value, list):
        return [_plain(item) for item in cast(list[Any], value)]
    return int(value) if isinstance(value, float) and value.is_integer() else value


class _Dumper(yaml.SafeDumper):
    """Puts names into quotes that would not be read as they are."""

    def represent_name(self, name: str) -> yaml.ScalarNode:
        try:
            plain = load_yaml(name) == name
        except CEIError:
            plain = False
        return cast(Any, self).represent_scalar("tag:yaml.org,2002:str", name, style=None if plain else '"')


_Dumper.add_representer(str, _Dumper.represent_name)


def _check(before: dict[str, Any], new: str, pads: Sequence[Sourced]) -> None:
    """Refuse what would not read as it should: pads as they are, and all else as it was."""
    try:
        after = load_yaml(new)
        right = [_values(pad) for pad in after["pads"]] == [_values(pad) for _, pad in pads]
        right &= after | {"pads": []} == before | {"pads": []}
    except (CEIError, KeyError, TypeError) as error:
        raise CEIError(f"the pads cannot be written into this YAML ({one_line(error)}); write them by hand.") from error
    if not right:
        raise CEIError(
            "the pads cannot be written into this YAML without changing what else it says; write them by hand."
        )
