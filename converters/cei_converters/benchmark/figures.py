"""What results depend on: `depends.yaml` in each folder of figures names, for each, its command, commit, seeds, versions and measured code.

A figure is a file, or files that were made together. The code is kept as digests (`measured_code`) of everything that was there, so that
no history is needed to say what has changed since, and so that what a figure measures can be put more exactly later.
"""

import dataclasses
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Self

import yaml

from cei_converters.benchmark.measured_code import Code, Digests
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_yaml

MANIFEST, DIRTY = "depends.yaml", "-dirty"
DESCRIPTION = "README.md"
"""The two files of a folder that are no figures."""


@dataclass(frozen=True)
class Figure:
    """Files that were made together, and of what.

    Attributes:
        files: names in the folder, or patterns of them.
        command: that makes them.
        commit: that they were made at, with `-dirty` where files had changed; None without a checkout.
        date: when, as YYYY-MM-DD.
        seeds: first and last.
        versions: of packages.
        measures: patterns of the code that the figure measures.
        code: name of the code's digests in the manifest.
        made_of: of a table or picture, patterns of the folder's files that it is made of; it is as old as they are.
        note: what else is to be known.
    """

    files: tuple[str, ...]
    command: str
    commit: str | None = None
    date: str | None = None
    seeds: tuple[int, int] | None = None
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    measures: tuple[str, ...] = ()
    code: str | None = None
    made_of: tuple[str, ...] = ()
    note: str = ""

    def has(self, name: str) -> bool:
        """Whether a file of the folder belongs to it."""
        return any(fnmatchcase(name, pattern) for pattern in self.files)

    def of_same_run(self, other: Self) -> bool:
        """Whether files of both may stand together, whatever is noted beside."""
        bare = {"files": (), "date": None, "note": ""}
        return replace(self, **bare) == replace(other, **bare)


class Manifest:
    """A folder's `depends.yaml`.

    Args:
        folder: of figures.
        figures: in it.
        code: digests by their own digest.
    """

    def __init__(self, folder: Path, figures: Iterable[Figure] = (), code: Mapping[str, Digests] | None = None) -> None:
        self.folder, self.figures, self.code = folder, [*figures], dict(code or {})

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The folder's; an empty one if it has none.

        Raises:
            CEIError: it cannot be read, or a figure of it is incomplete.
        """
        path = folder / MANIFEST
        if not path.exists():
            return cls(folder)
        try:
            found = load_yaml(path.read_text())
            figures = [_figure(entry) for entry in found["figures"]]
            code = {name: _digests(lines) for name, lines in found.get("code", {}).items()}
        except (OSError, CEIError, ValueError, TypeError, KeyError, AttributeError) as error:
            raise CEIError(f"{path} is no list of figures ({type(error).__name__}: {one_line(error)}).") from error
        for figure in figures:
            if figure.code is not None and figure.code not in code:
                raise CEIError(f"{path} has no code {figure.code}, of which {figure.files[0]} is said to be.")
        return cls(folder, figures, code)

    def write(self) -> None:
        """Write it, without code that is of no figure."""
        used = {figure.code for figure in self.figures}
        self.code = {name: digests for name, digests in self.code.items() if name in used}
        lines = {name: "".join(f"{digests[p]} {p}\n" for p in digests) for name, digests in self.code.items()}
        values = {"figures": [_entry(figure) for figure in self.figures], "code": lines}
        text = yaml.dump(values, Dumper=_Dumper, sort_keys=False, width=120, default_flow_style=None)
        (self.folder / MANIFEST).write_text(text)

    def names(self) -> list[str]:
        """Files in the folder that should belong to a figure."""
        found = (path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*") if path.is_file())
        return sorted(name for name in found if name not in (MANIFEST, DESCRIPTION) and not name.startswith("."))

    def figure(self, name: str) -> Figure:
        """The one that a file belongs to.

        Raises:
            CEIError: there is none, or more than one.
        """
        found = [figure for figure in self.figures if figure.has(name)]
        if len(found) == 1:
            return found[0]
        said = "no figure" if not found else f"{len(found)} figures"
        raise CEIError(
            f"{self.folder / name} belongs to {said} of {self.folder / MANIFEST}: name it there, with the command that made it."
        )

    def check(self) -> None:
        """Check that each file belongs to one figure, and that no figure is without a file.

        Raises:
            CEIError: it does not, or a file says another commit than its figure.
        """
        names = self.names()
        for name in names:
            said = said_by(self.folder / name).get("commit")
            figure = self.figure(name)
            if said is not None and not figure.made_of and said != figure.commit:
                raise CEIError(
                    f"{self.folder / name} says that it is of commit {said}, {self.folder / MANIFEST} of {figure.commit}."
                )
        for figure in self.figures:
            for pattern in (*figure.files, *figure.made_of):
                if not any(fnmatchcase(name, pattern) for name in names):
                    raise CEIError(f"{self.folder / MANIFEST} names {pattern}, which is not there.")

    def keep(self, figure: Figure, code: Code | None = None) -> None:
        """Say what files depend on, in place of what was said of them before."""
        if code is not None:
            self.code[code.name] = code.digests
            figure = replace(figure, code=code.name)
        others, place = [], len(self.figures)
        for other in self.figures:
            if other.of_same_run(figure):
                known = all(other.has(name) for name in figure.files)
                files = other.files if known else tuple(sorted({*other.files, *figure.files}))
                figure, place = replace(figure, files=files, note=other.note), len(others)
            elif not any(other.has(name) for name in figure.files):
                others.append(other)
            # a pattern gives way to names
            elif kept := tuple(name for name in self.names() if other.has(name) and not figure.has(name)):
                others.append(replace(other, files=kept))
        self.figures = [*others[:place], figure, *others[place:]]
        self.write()


def said_by(path: Path) -> dict[str, Any]:
    """What a result's file says of itself: its content if it is a JSON object, else nothing."""
    try:
        found = json.loads(path.read_text()) if path.suffix == ".json" else {}
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


class _Dumper(yaml.SafeDumper):
    """Lines stay lines."""


_Dumper.add_representer(
    str,
    lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None),
)


def _digests(lines: str) -> Digests:
    """Read the manifest's lines: a digest, and the path of its file. As values of YAML, some digests would be numbers."""
    return {path: digest for digest, _, path in (line.partition(" ") for line in lines.splitlines())}


def _figure(entry: dict[str, Any]) -> Figure:
    """Read a figure from the manifest's values."""
    listed = {key: tuple(entry[key]) for key in ("files", "seeds", "measures", "made_of") if entry.get(key)}
    values: dict[str, Any] = entry | listed
    return Figure(**values)


def _entry(figure: Figure) -> dict[str, Any]:
    """Give the manifest's values of a figure, without those that are the default."""
    found = {f.name: getattr(figure, f.name) for f in dataclasses.fields(figure)}
    found = {name: [*value] if isinstance(value, tuple) else value for name, value in found.items()}
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in found.items() if value}
