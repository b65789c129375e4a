"""What of other people's packages is not installed with the method alone: which extra of `cei-gym` brings a module, and one line for whom it
is missing. `tests/test_extras.py` holds this table against the packages' imports and pyproject.toml.

Only the standard library is imported.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import NamedTuple

from cei_gym.errors import CEIError


class Extra(NamedTuple):
    """An extra, `pip install "cei-gym[<name>]"`.

    Attributes:
        title: what it brings, in a word.
        modules: those that this project imports of it, the one that the title names first.
    """

    title: str
    modules: tuple[str, ...]


EXTRAS = {
    "lerobot": Extra(
        "LeRobot",
        (
            *("lerobot", "av", "cv2", "datasets", "h5py", "huggingface_hub", "jinja2", "matplotlib", "pyarrow", "rich"),
            *("threadpoolctl", "zarr"),
        ),
    ),
    "robosuite": Extra("robosuite", ("robosuite", "cei_envs")),
    "cluster": Extra("datatrove", ("datatrove", "loguru", "multiprocess")),
    "ray": Extra("Ray", ("ray",)),
    "view": Extra("rerun", ("rerun",)),
    "show": Extra("viser", ("viser",)),
    "descriptions": Extra("robot_descriptions and mujoco-menagerie", ("robot_descriptions", "mujoco_menagerie")),
    "torch": Extra("torch", ("torch", "pytorch_kinematics")),
}
"""The extras by name. What each of them brings besides is in pyproject.toml."""


class MissingExtra(CEIError, ModuleNotFoundError):
    """An extra is missing. The message is one line: who needs what, and how to install it."""


def installed(module: str) -> bool:
    """Whether a module is there to be imported; nothing is."""
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):  # somebody forbids it, or has put something else in its place
        return False


def missing(extra: str) -> str | None:
    """The first module of an extra that is not installed; None if all are."""
    return next((module for module in EXTRAS[extra].modules if not installed(module)), None)


def require(who: str, extra: str, bring: str | None = None) -> None:
    """Refuse, before any work is done, what cannot be done without all of an extra.

    Args:
        who: needs it: a command, an option, an environment.
        extra: name of what is needed.
        bring: name of the extra to install for it, where that brings more than the one needed.

    Raises:
        MissingExtra: some of it is not installed.
    """
    if (module := missing(extra)) is not None:
        raise lacking(who, module, bring)


def require_module(who: str, module: str) -> None:
    """Refuse, before any work is done, what cannot be done without one module of an extra.

    Raises:
        MissingExtra: it is not installed.
    """
    if not installed(module):
        raise lacking(who, module)


@contextmanager
def needed_by(who: str) -> Iterator[None]:
    """Explain a failing import in the block: of a module that an extra brings.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if isinstance(error, MissingExtra):
            raise
        module = (error.name or "").partition(".")[0]
        if extra_of(module) is None:
            raise
        raise lacking(who, module) from None


def extra_of(module: str) -> str | None:
    """Name of the extra that brings a top-level module; None if it comes with the method, or is unknown."""
    return next((name for name, extra in EXTRAS.items() if module in extra.modules), None)


def lacking(who: str, module: str, bring: str | None = None) -> MissingExtra:
    """The error of who needs a module that an extra brings; see `require`."""
    extra = extra_of(module)
    assert extra is not None, module
    title, (first, *_) = EXTRAS[extra]
    return MissingExtra(
        f'{who} needs {module if installed(first) else title}: pip install "cei-gym[{bring or extra}]".'
    )


def install_command(package: str) -> str:
    """How to install a Python package, an extra's or another."""
    extra = extra_of(package)
    return f"pip install {package}" if extra is None else f'pip install "cei-gym[{extra}]"'
