"""`--help`: draccus shows docstrings of nested options as they are, maybe code with them; here each option has its own words."""

import argparse
import dataclasses
import inspect
import re
import typing

_ATTRIBUTE = re.compile(r"^    (\w+): (.*(?:\n {5,}.*)*)", re.MULTILINE)


def explain(parser: argparse.ArgumentParser, config_cls: type) -> None:
    """Give each option of a parser that draccus made its help, and each group its summary.

    Args:
        parser: it is changed.
        config_cls: dataclass of the options. Those of dataclasses in it are explained by the `Attributes:` of their docstrings.
    """
    notes = _notes(config_cls)
    for group in parser._action_groups:
        group.title = re.sub(r"^\w+ \['(.+)'\]$", r"--\1.*", group.title or "")
        group.description = (group.description or "").partition("Attributes:")[0].strip() or None
        if group.title == config_cls.__name__:  # described by the command itself
            group.title, group.description = "main options", None
        for action in group._group_actions:
            name = action.option_strings[0].removeprefix("--")
            action.option_strings = [option.rstrip("_") for option in action.option_strings]
            if name in notes:
                action.help = notes[name].replace("%", "%%")
            elif name == "config_path":
                action.help = "YAML file with options, a key each; those of the command line win."
            elif (action.help or "").startswith("Config file for"):
                action.help = argparse.SUPPRESS
            if action.default is None:
                action.default = argparse.SUPPRESS


def _notes(config_cls: type, prefix: str = "") -> dict[str, str]:
    """Dotted name to what a docstring says of it."""
    hints = typing.get_type_hints(config_cls)
    attributes = inspect.cleandoc(config_cls.__doc__ or "").partition("Attributes:\n")[2]
    found = {name: " ".join(text.split()) for name, text in _ATTRIBUTE.findall(attributes)}
    notes = {prefix + name: text[:1].upper() + text[1:] for name, text in found.items()}
    for field in dataclasses.fields(config_cls):
        if dataclasses.is_dataclass(hints[field.name]):
            notes.pop(prefix + field.name, None)
            notes |= _notes(hints[field.name], f"{prefix}{field.name}.")
    return notes
