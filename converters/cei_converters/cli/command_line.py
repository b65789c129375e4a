"""Command lines shared by all tools: draccus options, one-line errors, exit codes."""

import contextlib
import dataclasses
import logging
import signal
import sys
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NoReturn

from cei_converters.cli.help import explain
from cei_gym.errors import CEIError, unknown

EXIT_OK, EXIT_ERROR, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130


@dataclass
class DatasetConfig:
    """The dataset: LeRobot's v3.0, v2.1 or v2.0; robosuite's or robomimic's HDF5; or the zarr of DP3 and DemoGen."""

    repo_id: str  # Name of the dataset, <user>/<name>.
    root: str | None = None  # Its folder; default: LeRobot's cache, else the hub.


@dataclass
class SourceConfig:
    """The dataset that another was converted from, to show beside it."""

    repo_id: str | None = None  # Its name.
    root: str | None = None  # Its folder or file.
    joint_map: str | None = None  # Its joint map, if it was converted with one.


def option_types(config_cls: type, prefix: str = "") -> dict[str, object]:
    """Dotted option name to type for every leaf field of a (nested) dataclass."""
    hints = typing.get_type_hints(config_cls)
    options: dict[str, object] = {}
    for field in dataclasses.fields(config_cls):
        if dataclasses.is_dataclass(hints[field.name]):
            options |= option_types(hints[field.name], f"{prefix}{field.name}.")
        else:
            options[prefix + field.name] = hints[field.name]
    return options


def _normalised(args: Sequence[str], options: dict[str, object]) -> list[str]:
    """Check option names; spell a bare `--flag` of a boolean option as `--flag=true`.

    A group of options may go by the option that decides about it: `--init=eis` is `--init.method=eis`, and `--verify`
    is `--verify.enabled=true`.
    """
    normalised = []
    for position, arg in enumerate(args):
        name, has_value, _ = arg.removeprefix("--").partition("=")
        for deciding in (f"{name}.method", f"{name}.enabled"):
            if arg.startswith("--") and name not in options and deciding in options:
                arg, name = f"--{deciding}" + arg.removeprefix(f"--{name}"), deciding
        if arg.startswith("--") and name not in ("help", "config_path"):
            if name not in options:
                raise unknown("option", f"--{name}", (f"--{option}" for option in options))
            following = args[position + 1] if position + 1 < len(args) else "--"
            if options[name] is bool and not has_value and following not in ("true", "false"):
                arg += "=true"
        normalised.append(arg)
    return normalised


def parse[Config](config_cls: type[Config], args: Sequence[str], prog: str, example: str) -> Config:
    """Options of a command line as a dataclass.

    Args:
        config_cls: dataclass whose docstring and field comments are the help text.
        args: the command line without the program's name.
        prog: the program's name.
        example: usage example printed below the help.

    Raises:
        CEIError: an option is unknown, missing, or not of its type.
        SystemExit: after `--help`.
    """
    import argparse

    import draccus
    from draccus.argparsing import ArgumentParser
    from draccus.utils import DecodingError, DraccusException

    options = option_types(config_cls)
    summary = (config_cls.__doc__ or "").strip()
    parser = ArgumentParser(
        config_cls,
        prog=prog,
        usage=f"{prog} --option=value ...",
        description=f"{summary}\n\n{example}",
        exit_on_error=False,
    )
    explain(parser.parser, config_cls)
    try:
        return parser.parse_args(_normalised(args, options))
    except DecodingError as error:
        where = ".".join(str(key) for key in error.key_path)
        raise CEIError(_decoding_message(where, error.message, prog)) from error
    except (argparse.ArgumentError, DraccusException, OSError, draccus.ParsingError) as error:
        if isinstance(error.__cause__, CEIError):  # what an option's own check says
            raise error.__cause__ from None
        raise CEIError(f"{' '.join(str(error).split())} See {prog} --help.") from error


def _decoding_message(where: str, message: str, prog: str) -> str:
    if message.startswith("Missing required field"):
        prefix = f"--{where}." if where else "--"
        names = ", ".join(prefix + name for name in message.split("`")[1::2])
        return f"{names} is required. See {prog} --help."
    return f"--{where}: {' '.join(message.split())}. See {prog} --help."


def _stop(_signal: int, _frame: object) -> NoReturn:
    raise KeyboardInterrupt


def quiet_libraries() -> None:
    """Keep libraries' warnings (LeRobot's on a missing FFmpeg is 80 lines) from burying the one line that matters."""
    logging.getLogger().setLevel(logging.ERROR)


def run[Config](
    config_cls: type[Config],
    func: Callable[[Config], object],
    args: Sequence[str] | None = None,
    *,
    prog: str,
    example: str,
) -> int:
    """Parse the command line, call `func(config)`, and return the process's exit code.

    Bad input prints `error: <one line>` to stderr and gives 1 (2 for a bad option); an interrupt gives 130.
    """
    quiet_libraries()
    previous = None
    with contextlib.suppress(ValueError):  # not in the main thread
        # a terminated run must clean up its unfinished output as an interrupted one does
        previous = signal.signal(signal.SIGTERM, _stop)
    try:
        config = parse(config_cls, sys.argv[1:] if args is None else args, prog, example)
    except CEIError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USAGE
    except SystemExit as request:  # --help
        return int(request.code or EXIT_OK)
    try:
        func(config)
    except (CEIError, OSError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    finally:
        if previous is not None:
            signal.signal(signal.SIGTERM, previous)
    return EXIT_OK
