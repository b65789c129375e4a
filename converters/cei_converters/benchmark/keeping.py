"""Saying what results depend on: by the benchmark that makes them, or afterwards, from history."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

from cei_converters.benchmark.figures import DIRTY, Figure, Manifest, said_by
from cei_converters.benchmark.measured import measured_by
from cei_converters.benchmark.measured_code import Code, checkout, git
from cei_converters.dataset.provenance import PACKAGES, command_line, git_commit, versions
from cei_gym.errors import CEIError


@dataclass(frozen=True)
class Run:
    """What a benchmark's process runs; made at its start, since files may change until it ends.

    Attributes:
        commit: of the checkout, None without one.
        versions: of packages.
        code: of the checkout, None without one.
    """

    commit: str | None
    versions: Mapping[str, str]
    code: Code | None

    @classmethod
    def now(cls, packages: Iterable[str] = PACKAGES) -> Self:
        """This process's."""
        root = checkout()
        return cls(git_commit(), versions(packages), None if root is None else Code.of_folder(root))


def command_of(prog: str, config: Any, *left_out: str) -> str:
    """A benchmark's command.

    Args:
        prog: its words, such as `cei-benchmark replay`.
        config: its options.
        left_out: names of those that only say where things are put, and how.
    """
    default = type(config)()
    return command_line(prog, replace(config, **{name: getattr(default, name) for name in left_out}))


def keep(folder: Path, files: Iterable[str], command: str, run: Run, seeds: Sequence[int] | None = None) -> None:
    """Say in a folder's `depends.yaml` what files depend on that a benchmark has made.

    Args:
        folder: of figures.
        files: their names.
        command: that made them; what it measures is in `measured`.
        run: what the process runs.
        seeds: first and last.

    Raises:
        CEIError: what the command measures is not known, or the folder's `depends.yaml` cannot be read.
    """
    ends = None if seeds is None else (int(seeds[0]), int(seeds[-1]))
    date = datetime.now(UTC).date().isoformat()
    figure = Figure(tuple(files), command, run.commit, date, ends, run.versions, measured_by(command))
    Manifest.read(folder).keep(figure, run.code)


def keep_cell(
    folder: Path, name: str, found: Mapping[str, Any], command: str, run: Run, seeds: Sequence[int], *also: str
) -> None:
    """Keep a finished cell at once: write its file, with what made it, and say in `depends.yaml` what it depends on.

    Args:
        folder: of figures.
        name: of its file.
        found: settings and results.
        command: that made it.
        run: what the process runs.
        seeds: first and last.
        also: names of files that were made with it.

    Raises:
        CEIError: as `keep`.
    """
    from cei_converters.cli.outputs import Output
    from cei_converters.cli.result import write_json

    made_by = {"commit": run.commit, "versions": run.versions, "date": datetime.now(UTC).isoformat(timespec="seconds")}
    write_json(Output(folder / name), dict(found) | made_by)
    keep(folder, [name, *also], command, run, seeds)


def keep_derived(folder: Path, files: Iterable[str], command: str, made_of: str) -> None:
    """Say in a folder's `depends.yaml` which files of it tables and pictures are made of (a pattern).

    Raises:
        CEIError: the folder's `depends.yaml` cannot be read.
    """
    Manifest.read(folder).keep(Figure(tuple(files), command, made_of=(made_of,)))


def fill(manifest: Manifest, root: Path) -> int:
    """Take from history the code of figures that have none, at the commit that they or their files name; returns how many there were.

    Raises:
        CEIError: there is no such commit, or files that were made together name several.
    """
    missing = [figure for figure in manifest.figures if figure.code is None and not figure.made_of]
    for figure in missing:
        said = [said_by(manifest.folder / name) for name in manifest.names() if figure.has(name)]
        complete = _completed(figure, [each for each in said if each.get("commit")], manifest.folder)
        commit = str(complete.commit).removesuffix(DIRTY)
        date = complete.date or git(root, "show", "-s", "--format=%cs", commit).decode().strip()
        code = Code.of_commit(root, commit)
        manifest.code[code.name] = code.digests
        manifest.figures[manifest.figures.index(figure)] = replace(complete, date=date, code=code.name)
    if missing:
        manifest.write()
    return len(missing)


def _completed(figure: Figure, said: list[dict[str, Any]], folder: Path) -> Figure:
    """A figure with what its files say of themselves."""
    commits = {str(each["commit"]) for each in said} | ({figure.commit} if figure.commit else set())
    if len(commits) != 1:
        raise CEIError(f"{folder / figure.files[0]} should name one commit; it names {len(commits)}.")
    first = said[0] if said else {}
    dates = sorted(str(each["date"])[:10] for each in said if each.get("date"))
    seeds = figure.seeds or first.get("seeds")
    return replace(
        figure,
        commit=commits.pop(),
        date=figure.date or (dates[-1] if dates else None),
        seeds=None if seeds is None else (seeds[0], seeds[-1]),
        versions=figure.versions or first.get("versions", {}),
        measures=figure.measures or measured_by(figure.command),
    )
