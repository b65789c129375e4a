"""Collect how a dataset comes about: versions, commit, date, command line, fingerprint of the source."""

import hashlib
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import cei_gym
from cei_converters.dataset.metadata import Provenance, Source, plain

PACKAGES = ("cei-gym", "lerobot_env_cei", "lerobot", "datasets", "mujoco", "robosuite", "torch", "numpy")


def collect(options: object, *, source: Source | None = None, pads: Mapping[str, Any] | None = None) -> Provenance:
    """Provenance of the running command.

    Args:
        options: the (dataclass) options that shape the result.
        source: the dataset that is converted, if any.
        pads: the functional pads that were used, if any.
    """
    return Provenance(
        source=source,
        options=plain(options),
        pads=plain(dict(pads or {})),
        versions=versions(PACKAGES),
        git_commit=git_commit(),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command_line(sys.argv),
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
    """Commit of the checkout that cei_gym is imported from, `-dirty` if changed; None if there is none."""
    package = Path(cei_gym.__file__)
    try:
        # a package installed inside some other checkout is ignored or untracked there
        _git(package.parent, "ls-files", "--error-unmatch", package.name)
        return _git(package.parent, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    except (OSError, subprocess.CalledProcessError):
        return None


def _git(folder: Path, *args: str) -> str:
    command = ["git", "-C", str(folder), *args]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def command_line(argv: list[str]) -> str:
    """The command, with absolute paths cut to their last part: it is published with the dataset."""
    return shlex.join(_without_folders(arg) for arg in argv)


def _without_folders(arg: str) -> str:
    option, equals, value = arg.rpartition("=")
    return f"{option}{equals}{Path(value).name}" if Path(value).is_absolute() else arg


def fingerprint(root: Path) -> str:
    """SHA-256 over the names and bytes of a dataset's `meta/`, `data/` and `videos/` files."""
    digest = hashlib.sha256()
    for path in sorted(p for folder in ("meta", "data", "videos") for p in (root / folder).rglob("*") if p.is_file()):
        digest.update(path.relative_to(root).as_posix().encode())
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return f"sha256:{digest.hexdigest()}"
