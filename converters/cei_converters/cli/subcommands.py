"""A command of several: `cei-robot new`, `cei-benchmark replay`."""

import importlib
import sys
from collections.abc import Mapping
from typing import NamedTuple

from cei_converters.cli.command_line import EXIT_OK, EXIT_USAGE
from cei_gym.errors import unknown


class Subcommand(NamedTuple):
    """One of them.

    Attributes:
        module: with its `main`; imported when it is asked for.
        gives: what it gives, in a few words.
        first: the option that may go without its name; "" is none.
    """

    module: str
    gives: str
    first: str = ""


def dispatch(prog: str, commands: Mapping[str, Subcommand], args: list[str] | None, what: str = "command") -> int:
    """Run the one that a command line begins with; returns the exit code.

    Args:
        prog: what they are of.
        commands: by name.
        args: the command line; default: this process's.
        what: what they are called.
    """
    name, *options = (sys.argv[1:] if args is None else args) or ["--help"]
    if name in ("-h", "--help"):
        print(f"usage: {prog} {what.upper()} --option=value ...\n")
        width = max(map(len, commands))
        for each, command in commands.items():
            print(f"  {each:{width}}  {command.gives}; see {prog} {each} --help")
        return EXIT_OK
    if name not in commands:
        print(f"error: {unknown(what, name, commands)}", file=sys.stderr)
        return EXIT_USAGE
    command = commands[name]
    if command.first and options and not options[0].startswith("-"):
        options[0] = f"--{command.first}={options[0]}"
    return importlib.import_module(command.module).main(options)
