"""Command lines shared by all tools: options into dataclasses, one-line errors, exit codes."""

import dataclasses
import json
import logging
import os
import signal
import sys
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_converters import signals
from cei_converters.cli.help import explain
from cei_converters.cli.values import home_expanded, is_optional, is_path, read_value
from cei_gym import extras
from cei_gym.errors import CEIError, one_line, unknown
from cei_gym.untrusted import load_yaml

EXIT_OK, EXIT_ERROR, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130
CONFIG_PATH = "config_path"


@dataclass
class DatasetConfig:
    """The dataset: LeRobot's v3.0, v2.1 or v2.0; robosuite's or robomimic's HDF5; or the zarr of DP3 and DemoGen."""

    repo_id: str  # Name of the dataset, <user>/<name>.
    root: Path | None = None  # Its folder; default: LeRobot's cache, else the hub.


@dataclass
class SourceConfig:
    """The dataset that another was converted from, to show beside it."""

    repo_id: str | None = None  # Its name.
    root: Path | None = None  # Its folder or file.

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if self.repo_id is None and value is not None:
                raise CEIError(f"--source.{name} is of no use without --source.repo_id.")


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


def parse[Config](config_cls: type[Config], args: Sequence[str], prog: str, example: str) -> Config:
    """Options of a command line as a dataclass.

    Args:
        config_cls: dataclass whose docstring and field comments are the help text.
        args: the command line without the program's name. With `--config_path=FILE.yaml`, options of the file hold too, but for those
            that the command line gives.
        prog: the program's name.
        example: usage example printed below the help.

    Raises:
        CEIError: an option is unknown, missing, given twice, or not of its type.
        SystemExit: after `--help`.
    """
    import draccus
    from draccus.utils import DecodingError, DraccusException, deflatten

    if {"--help", "-h"} & set(args):
        _print_help(config_cls, prog, example)
        raise SystemExit(EXIT_OK)
    options, see = option_types(config_cls), f" See {prog} --help."
    given = _given(args, options)
    values: dict[str, Any] = {}
    if (file := given.pop(CONFIG_PATH, None)) is not None:
        values = _of_file(Path(home_expanded(f"--{CONFIG_PATH}", file)), options)
    values |= {name: read_value(f"--{name}", text, options[name]) for name, text in given.items()}
    for name, value in values.items():
        if value is None and not is_optional(options[name]):
            raise CEIError(f"--{name} is null; give it a value, or leave it out.{see}")
        if is_path(options[name]) and value is not None:
            paths = [home_expanded(f"--{name}", str(path)) for path in (value if isinstance(value, list) else [value])]
            values[name] = paths if isinstance(value, list) else paths[0]
    if missing := [f"--{name}" for name in _required(config_cls) if name not in values]:
        raise CEIError(f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} required.{see}")
    try:
        return draccus.decode(config_cls, deflatten(values, sep="."))
    except DecodingError as error:
        where = ".".join(str(key) for key in error.key_path)
        raise CEIError(f"--{where}: {one_line(error.message)}.{see}") from error
    except DraccusException as error:
        if isinstance(error.__cause__, CEIError):  # what an option's own check says
            raise error.__cause__ from None
        raise CEIError(f"{one_line(error)}{see}") from error


def _print_help(config_cls: type, prog: str, example: str) -> None:
    from draccus.argparsing import ArgumentParser

    description = f"{(config_cls.__doc__ or '').strip()}\n\n{example}"
    usage = f"{prog} --option=value ..."
    parser = ArgumentParser(config_cls, prog=prog, usage=usage, description=description).parser
    explain(parser, config_cls)
    parser.print_help()


def _given(args: Sequence[str], options: Mapping[str, object]) -> dict[str, str]:
    """Option name to the text that is given: `--name=text`, `--name text`, or a bare `--flag`, which is true.

    A group of options may go by the option that decides about it: `--init=eis` is `--init.method=eis`, and `--verify`
    is `--verify.enabled`.
    """
    given: dict[str, str] = {}
    rest = list(args)
    while rest:
        arg = rest.pop(0)
        name, has_text, text = arg.removeprefix("--").partition("=")
        if not arg.startswith("--") or not name:
            raise CEIError(f"{one_line(arg, 60)!r} belongs to no option; options read --name=value.")
        name = _full_name(name, options)
        if not has_text:
            follows = rest[0] if rest and not rest[0].startswith("--") else None
            if options.get(name) is bool:
                follows = follows if follows in ("true", "false") else None
                text = follows or "true"
            elif follows is None:
                raise CEIError(f"--{name} needs a value: --{name}=...")
            text = follows or text
            del rest[: follows is not None]
        if name in given:
            raise CEIError(f"--{name} is given twice.")
        given[name] = text
    return given


def _full_name(name: str, options: Mapping[str, object]) -> str:
    """An option's name, also where its group's is given.

    Raises:
        CEIError: there is none.
    """
    for known in (
        name,
        f"{name}_",
        f"{name}.method",
        f"{name}.enabled",
    ):  # the second where Python has another use for it
        if known in options or known == CONFIG_PATH:
            return known
    raise unknown("option", f"--{name}", (f"--{option.rstrip('_')}" for option in options))


def _of_file(path: Path, options: Mapping[str, object]) -> dict[str, Any]:
    """Option name to value, of a YAML file with one key an option or a group of options.

    Raises:
        CEIError: it cannot be read, or has what is no option, or no option's value.
    """
    where = f"--{CONFIG_PATH}={path}"
    try:
        raw = load_yaml(path.read_text())
    except (OSError, ValueError) as error:
        raise CEIError(f"{where} cannot be read: {one_line(error)}.") from error
    if not isinstance(raw, Mapping):
        raise CEIError(f"{where} should have a key for each option.")
    found: dict[str, Any] = {}
    for key, value in _flat(raw):
        try:
            name = _full_name(key, options)
        except CEIError as error:
            raise CEIError(f"{where}: {error}") from None
        if isinstance(value, (bool, float, list)) and options[name] in (str, str | None, Path, Path | None):
            raise CEIError(f"{where}: {name} is {one_line(value, 60)}; put it in quotes if that is its name.")
        if value is not None:
            text = json.dumps(value) if isinstance(value, (bool, int, float, list)) else str(value)
            value = read_value(f"{where}: {name}", text, options[name])
        found[name] = value
    return found


def _flat(raw: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in raw.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _required(config_cls: type, prefix: str = "") -> Iterator[str]:
    """Dotted names of options without a default."""
    hints = typing.get_type_hints(config_cls)
    for field in dataclasses.fields(config_cls):
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            if dataclasses.is_dataclass(hints[field.name]):
                yield from _required(hints[field.name], f"{prefix}{field.name}.")
            else:
                yield prefix + field.name


def quiet_libraries() -> None:
    """Keep libraries' warnings (LeRobot's on a missing FFmpeg is 80 lines, the AV1 encoder's 30 a video) from burying the one line that
    matters."""
    logging.getLogger().setLevel(logging.ERROR)
    os.environ.setdefault("SVT_LOG", "1")  # errors alone


def run[Config](
    config_cls: type[Config],
    func: Callable[[Config], object],
    args: Sequence[str] | None = None,
    *,
    prog: str,
    example: str,
) -> int:
    """Parse the command line, call `func(config)`, and return the process's exit code.

    Bad input prints `error: <one line>` to stderr and gives 1 (2 for a bad option); a signal gives 128 and its number.
    """
    quiet_libraries()
    with signals.heeded():
        try:
            return _run(config_cls, func, args, prog, example)
        except BaseException as error:
            if signals.received() is None and not isinstance(error, KeyboardInterrupt):
                raise
        return _interrupted()


def _run[Config](
    config_cls: type[Config], func: Callable[[Config], object], args: Sequence[str] | None, prog: str, example: str
) -> int:
    try:
        config = parse(config_cls, sys.argv[1:] if args is None else args, prog, example)
    except CEIError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_USAGE
    except SystemExit as request:  # --help
        return int(request.code or EXIT_OK)
    try:
        with extras.needed_by(prog):
            func(config)
        sys.stdout.flush()  # what cannot be told is an error, too
    except (CEIError, OSError) as error:
        if signals.received() is not None:  # a library has its own words for being interrupted
            raise KeyboardInterrupt from error
        if isinstance(error, BrokenPipeError) and _nobody_reads():
            return 128 + signal.SIGPIPE
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_ERROR
    if signals.received() is not None:  # something swallowed it
        raise KeyboardInterrupt
    return EXIT_OK


def _interrupted() -> int:
    signals.tidy_up()
    number = signals.received()
    print("interrupted" if number is None else signals.word(number), file=sys.stderr)
    return EXIT_INTERRUPTED if number is None else 128 + number


def _nobody_reads() -> bool:
    """Whether stdout leads nowhere any more, as after `| head`; what is left to print is then dropped."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return True
    return False
