"""Which results are older than what they measure, and what has changed since."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from cei_converters.benchmark.figures import DIRTY, MANIFEST, Figure, Manifest
from cei_converters.benchmark.measured_code import Code, changes
from cei_gym.errors import CEIError

LIBRARIES = ("mujoco", "robosuite", "numpy", "numba")
"""Libraries whose versions every figure depends on."""
LEARNING = ("torch", "lerobot")
"""Libraries that figures of policies depend on, too."""


@dataclass(frozen=True)
class Aged:
    """A figure and its age.

    Attributes:
        folder: that it is in.
        figure: as its manifest has it.
        commits: that it was measured at.
        changed: files and libraries that it measures and that have changed since; none where it is as the code is.
    """

    folder: Path
    figure: Figure
    commits: tuple[str, ...]
    changed: tuple[str, ...]

    @property
    def is_older(self) -> bool:
        """Whether it is older than what it measures."""
        return bool(self.changed)


def shortened(commit: str) -> str:
    """A commit's first seven digits, and whether files had changed."""
    return commit[:7] + DIRTY * commit.endswith(DIRTY)


def ages(results: Path) -> list[Aged]:
    """All figures of a checkout's folder of results.

    Raises:
        CEIError: a file belongs to no figure, or a manifest cannot be read.
    """
    if not results.is_dir():
        raise CEIError(f"{results} is no folder of results.")
    if loose := [path for path in results.iterdir() if path.is_file() and path.name != "README.md"]:
        raise CEIError(f"{loose[0]} is in no folder of figures, so nothing says what it depends on.")
    now, locked = Code.of_folder(results.resolve().parent), _locked(results.resolve().parent)
    return [
        aged for folder in sorted(filter(Path.is_dir, results.iterdir())) for aged in _of_folder(folder, now, locked)
    ]


def _of_folder(folder: Path, now: Code, locked: Mapping[str, str]) -> list[Aged]:
    manifest = Manifest.read(folder)
    manifest.check()
    measured = [
        Aged(folder, figure, (str(figure.commit),), _changed(manifest, figure, now, locked))
        for figure in manifest.figures
        if not figure.made_of
    ]
    return [*measured, *(_derived(manifest, figure, measured) for figure in manifest.figures if figure.made_of)]


def _changed(manifest: Manifest, figure: Figure, now: Code, locked: Mapping[str, str]) -> tuple[str, ...]:
    if figure.code is None:
        return (f"unknown: {manifest.folder / MANIFEST} has no code of it",)
    libraries = (*LIBRARIES, *(LEARNING if any(p.startswith("policies/") for p in figure.measures) else ()))
    newer = (
        f"{name} {figure.versions[name]}, now {locked[name]}"
        for name in libraries
        if name in figure.versions and name in locked and figure.versions[name] != locked[name]
    )
    return (*changes(manifest.code[figure.code], now, figure.measures), *newer)


def _derived(manifest: Manifest, figure: Figure, measured: list[Aged]) -> Aged:
    """A table or a picture: as old as the files that it is made of."""
    names = [name for name in manifest.names() if any(fnmatchcase(name, pattern) for pattern in figure.made_of)]
    parts = [aged for aged in measured if any(aged.figure.has(name) for name in names)]
    commits = dict.fromkeys(commit for part in parts for commit in part.commits)
    return Aged(manifest.folder, figure, (*commits,), (*dict.fromkeys(c for part in parts for c in part.changed),))


def _locked(root: Path) -> dict[str, str]:
    """Versions of libraries by name, as the checkout pins them."""
    path = root / "requirements.lock"
    text = path.read_text() if path.is_file() else ""
    return dict(re.findall(r"^([A-Za-z0-9_.-]+)==([^\s;]+)", text, re.MULTILINE))
