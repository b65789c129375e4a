"""`cei-robot`: what it does, by its name."""

import importlib
import sys

from cei_converters.cli.command_line import EXIT_OK, EXIT_USAGE
from cei_gym.errors import unknown

COMMANDS = {
    "new": ("description", "a YAML from a robot's description, with what is unsure marked"),
    "check": ("robot", "what is wrong with a YAML, in plain words"),
    "show": ("robot", "a robot in the browser: sliders, pads with normals, frames, what touches"),
    "list": (None, "the robots there are, and what each is good for"),
}
"""Name to the option that may go without its name, and what it gives."""


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-robot`."""
    name, *options = (sys.argv[1:] if args is None else args) or ["--help"]
    if name in ("-h", "--help"):
        print("usage: cei-robot COMMAND --option=value ...\n")
        for command, (_, what) in COMMANDS.items():
            print(f"  {command:5}  {what}; see cei-robot {command} --help")
        return EXIT_OK
    if name not in COMMANDS:
        print(f"error: {unknown('command', name, COMMANDS)}", file=sys.stderr)
        return EXIT_USAGE
    first = COMMANDS[name][0]
    if first is not None and options and not options[0].startswith("-"):
        options[0] = f"--{first}={options[0]}"
    module = {"list": "listing"}.get(name, name)
    return importlib.import_module(f"{__package__}.{module}").main(options)


if __name__ == "__main__":
    from cei_converters import start

    raise SystemExit(start.robot())
