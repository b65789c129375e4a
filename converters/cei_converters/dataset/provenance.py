"""Collect how a dataset comes about: versions, commit, date, options, what it was made of. Names are published, never paths."""

import dataclasses
import hashlib
import os
import platform
import shlex
import subprocess
import typing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import cei_gym
from cei_converters.dataset.license import CARD_PATH, license_files
from cei_converters.dataset.locate import INFO_PATH
from cei_converters.dataset.metadata import Provenance, Source, plain
from cei_gym.errors import CEIError, one_line

PACKAGES = ("cei-gym", "lerobot_env_cei", "lerobot", "datasets", "mujoco", "robosuite", "torch", "numpy")
INCIDENTAL = (
    *("root", "new_root", "json", "overwrite", "dry_run", "push_to_hub", "private", "branch", "pull_request"),
    *("workers", "executor", "slurm", "shard_episodes", "resume"),
)
"""Options of commands that make a dataset which say where and how it is made, not what it becomes. They are nobody else's business."""

_FOLDERS = ("meta", "data", "videos", "images")
_NO_DATA = ("._", ".DS_Store")  # what some systems put beside every file


def collect(
    options: Mapping[str, Any],
    command: str = "",
    *,
    source: Source | None = None,
    inputs: Mapping[str, str] | None = None,
    pads: Mapping[str, Any] | None = None,
    notes: Mapping[str, Sequence[str]] | None = None,
    packages: Mapping[str, str] | None = None,
) -> Provenance:
    """Provenance of a dataset that is made now.

    Args:
        options: those that shape it; see `published`.
        command: that makes it; see `command_line`.
        source: the dataset that is converted, if any.
        inputs: what else it is made of, to its fingerprint.
        pads: the functional pads that are used, if any.
        notes: what was assumed or left out of robots' descriptions, by their names.
        packages: versions of packages whose additions are used, by name.
    """
    return Provenance(
        source=source,
        options=plain(options),
        inputs=dict(inputs or {}),
        pads=plain(dict(pads or {})),
        notes={name: [*each] for name, each in (notes or {}).items() if each},
        versions=versions(PACKAGES) | dict(packages or {}),
        git_commit=git_commit(),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command,
    )


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Installed versions by distribution name, and Python's."""
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def git_commit() -> str | None:
    """Commit of the checkout that cei_gym is imported from, `-dirty` if changed; None if there is none.

    Figures that a benchmark has written change nothing of what the next one measures: `results` is not looked at.
    """
    package = Path(cei_gym.__file__)
    try:
        # a package installed inside some other checkout is ignored or untracked there
        _git(package.parent, "ls-files", "--error-unmatch", package.name)
        changed = _git(
            package.parent, "status", "--porcelain", "--untracked-files=no", "--", ":/", ":(top,exclude)results"
        )
        return _git(package.parent, "rev-parse", "HEAD") + ("-dirty" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return None


def _git(folder: Path, *args: str) -> str:
    command = ["git", "-C", str(folder), *args]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


# -- options ------------------------------------------------------------------------------------------------------------


def published(options: Any, prefix: str = "") -> dict[str, Any]:
    """Options (a dataclass) that shape a dataset, as others may see them: of a path its last part.

    Those without a value are left out, and groups that are not enabled.

    Args:
        options: of a command, or a group of them.
        prefix: the group's name and a dot.
    """
    found: dict[str, Any] = {}
    for name, hint, value in _fields(options, prefix):
        if dataclasses.is_dataclass(value):
            if getattr(value, "enabled", True):
                found[name] = published(value, f"{prefix}{name}.")
        elif value is not None:
            found[name] = _named(value, hint)
    return found


def command_line(prog: str, options: Any) -> str:
    """A command with those of its options (a dataclass) that shape a dataset and differ from their defaults, as others may see them."""
    return shlex.join([*prog.split(), *(f"--{name}={_text(value)}" for name, value in _given(options))])


def _given(options: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    defaults = {field.name: field.default for field in dataclasses.fields(options)}
    for name, hint, value in _fields(options, prefix):
        if dataclasses.is_dataclass(value):
            yield from _given(value, f"{prefix}{name}.")
        elif value != defaults[name]:
            yield prefix + name, _named(value, hint)


def _fields(options: Any, prefix: str) -> Iterator[tuple[str, Any, Any]]:
    """Name, type and value of each option that is not incidental."""
    hints = typing.get_type_hints(type(options))
    for field in dataclasses.fields(options):
        if prefix + field.name not in INCIDENTAL:
            yield field.name, hints[field.name], getattr(options, field.name)


def _named(value: Any, hint: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return [_named(item, hint) for item in value]
    if isinstance(value, Path) or (value is not None and Path in (hint, *typing.get_args(hint))):
        return Path(value).name
    return value


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


# -- fingerprints -------------------------------------------------------------------------------------------------------


def fingerprint(path: Path) -> str:
    """SHA-256 of what a dataset's content is: a file's bytes; of a folder the names and bytes of what LeRobot reads, the card and licenses;
    or, in other folders (zarr), of all files. A gigabyte takes about a second.

    Raises:
        CEIError: there is no file, or it cannot be read.
    """
    digest, count = hashlib.sha256(), 0
    try:
        for file in _files(path):
            digest.update(file.relative_to(path).as_posix().encode(errors="surrogateescape") + b"\0")
            with file.open("rb") as opened:
                digest.update(hashlib.file_digest(opened, "sha256").digest())
            count += 1
    except OSError as error:
        raise CEIError(f"{path} cannot be read: {one_line(error)}.") from error
    if not count:
        raise CEIError(f"{path} has no files.")
    return f"sha256:{digest.hexdigest()}"


def _files(path: Path) -> Iterator[Path]:
    """Files of a dataset in an order that only their names decide; links to folders, as of data on another disk, are followed."""
    if path.is_file():
        yield path
    elif (path / INFO_PATH).is_file():
        found = [file for name in _FOLDERS for file in _walk(path / name)]
        own = [path / CARD_PATH] if (path / CARD_PATH).is_file() else []
        yield from sorted([*found, *own, *license_files(path)])
    else:
        yield from sorted(_walk(path))


def _walk(folder: Path, above: tuple[Path, ...] = ()) -> Iterator[Path]:
    above = (*above, folder.resolve())
    for entry in os.scandir(folder) if folder.is_dir() else ():
        path = Path(entry.path)
        if entry.name.startswith(_NO_DATA):
            continue
        if not entry.is_dir():
            yield path
        elif path.resolve() not in above:  # a link back
            yield from _walk(path, above)
