"""The files that a xacro reads: includes and YAML, each inside its root or a package, and all of them bounded."""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from math import pi
from pathlib import Path
from xml.etree.ElementTree import Element

from cei_gym.embodiment.resources import SCHEME, Place, read_file, within
from cei_gym.embodiment.xacro.expressions import Evaluator
from cei_gym.embodiment.xacro.functions import Value, size
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_yaml
from cei_gym.untrusted_xml import MAX_BYTES, load_xml

_MOST_YAML_BYTES = 1_000_000
_UNITS = {
    "!radians": 1.0,
    "!degrees": pi / 180,
    "!meters": 1.0,
    "!millimeters": 0.001,
    "!foot": 0.3048,
    "!inches": 0.0254,
}


class _NoPackageError(CEIError):
    """A package is not there."""


@dataclass(frozen=True)
class _File:
    """A file, and the folder that what it names must stay inside."""

    path: Path
    root: Path


class Files:
    """The files of one xacro, each read once.

    Args:
        place: where it is.
    """

    def __init__(self, place: Place) -> None:
        self._place = place
        self._open = [_File(place.path, place.root)]
        self._packages: dict[str, Path] = {}
        self._trees: dict[Path, Element] = {}
        self._yaml: dict[Path, Value] = {}
        self._numbers = Evaluator({})
        self._bytes = {"xml": MAX_BYTES, "yaml": _MOST_YAML_BYTES}

    @property
    def included(self) -> str:
        """Name of the included file that is being expanded; empty in the xacro itself."""
        return self._open[-1].path.name if len(self._open) > 1 else ""

    @contextmanager
    def opened(self, name: str, optional: bool) -> Generator[Element | None]:
        """The elements of an included file; None of one that is optional and not there. Relative names in the block start from it.

        An error leaves it the one that is being expanded, for messages.

        Raises:
            CEIError: it is missing, lies outside, includes itself, or is no XML.
        """
        try:
            file = self._find(name)
        except _NoPackageError:
            if not optional:
                raise
            file = None
        if file is None or (optional and not file.path.is_file()):
            yield None
            return
        if file in self._open:
            raise CEIError(f"{one_line(name, 60)!r} includes itself")
        if file.path not in self._trees:
            content = self._read(file, name, "xml")
            try:
                self._trees[file.path] = load_xml(content)
            except CEIError as error:
                raise CEIError(f"{one_line(name, 60)}: {error}") from None
        self._open.append(file)
        yield self._trees[file.path]
        self._open.pop()

    def load_yaml(self, name: str) -> tuple[Value, int]:
        """What a YAML holds, and how much work that was.

        Raises:
            CEIError: it is missing, lies outside, or is no YAML.
        """
        file = self._find(name)
        if file.path not in self._yaml:
            try:
                content = load_yaml(
                    self._read(file, name, "yaml").decode(),
                    {
                        tag: lambda text, unit=unit: unit * float(self._numbers.value(text, dict[str, Value]()))
                        for tag, unit in _UNITS.items()
                    },
                )
            except (CEIError, UnicodeDecodeError) as error:
                raise CEIError(f"{one_line(name, 60)}: {one_line(error)}") from None
            self._yaml[file.path] = content
        return self._yaml[file.path], size(self._yaml[file.path])

    def _find(self, name: str) -> _File:
        """A file relative to the one that is being expanded, or of a package."""
        uri = name.removeprefix("file://")
        if not uri.startswith(SCHEME):
            here = self._open[-1]
            return _File(within(here.root, here.path.parent / uri, name), here.root)
        package, _, inside = uri.removeprefix(SCHEME).partition("/")
        if package not in self._packages:
            try:
                self._packages[package] = self._place.package(package)
            except CEIError as error:
                raise _NoPackageError(str(error)) from None
        folder = self._packages[package]
        path = within(folder, folder / inside, name)
        return _File(path, self._place.root if folder.is_relative_to(self._place.root) else folder)

    def _read(self, file: _File, name: str, kind: str) -> bytes:
        content = read_file(file.path, name, self._bytes[kind])
        self._bytes[kind] -= len(content)
        return content
