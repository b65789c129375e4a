"""`cei-robot`: what it does, by its name."""

from cei_converters.cli.subcommands import Subcommand, dispatch

COMMANDS = {
    "new": Subcommand(
        "cei_converters.robot.new",
        "a YAML from a robot's description, with what is unsure marked",
        "description",
    ),
    "check": Subcommand("cei_converters.robot.check", "what is wrong with a YAML, in plain words", "robot"),
    "show": Subcommand(
        "cei_converters.robot.show",
        "a robot in the browser: sliders, pads with normals, frames, what touches",
        "robot",
    ),
    "list": Subcommand("cei_converters.robot.listing", "the robots there are, and what each is good for"),
}
"""By name."""


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-robot`."""
    return dispatch("cei-robot", COMMANDS, args)


if __name__ == "__main__":
    from cei_converters import start

    raise SystemExit(start.robot())
