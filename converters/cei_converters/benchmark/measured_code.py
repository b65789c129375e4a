"""The code that a figure measures: a digest a file, of what the file does and not of how it is written.

Of a Python file the syntax tree counts, without docstrings and other bare strings; comments, blank lines and quotes are in no tree. Neither
does the order of imports that follow each other count. Of YAML the values count, of every other file the bytes. A file that has moved is
the same file, and so are those that import it from its new place.
"""

import ast
import hashlib
import io
import itertools
import json
import subprocess
import tarfile
from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Self

import cei_gym
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_yaml

ROOTS = ("benchmarks", "cei_gym", "converters", "envs", "policies")
"""Folders of a checkout whose files are code."""

type Digests = Mapping[str, str]
"""Digest by a file's path in the checkout."""

_ABOVE_PACKAGES = {*ROOTS} - {"cei_gym"}
_MADE = {"__pycache__", "build", "dist"}
_MADE_SUFFIXES = {".pyc", ".nbi", ".nbc"}
_DIGITS = 12


class Code:
    """All code of a checkout at one time, read at once and parsed when asked for.

    Args:
        files: content by path in the checkout.
    """

    def __init__(self, files: Mapping[str, bytes]) -> None:
        self._files = files

    @classmethod
    def of_folder(cls, checkout: Path) -> Self:
        """The files that lie there now, committed or not."""
        paths = [path for root in ROOTS for path in (checkout / root).rglob("*") if path.is_file()]
        found = {path.relative_to(checkout).as_posix(): path for path in paths if path.suffix not in _MADE_SUFFIXES}
        ours = {name: path for name, path in found.items() if not _MADE & {*name.split("/")} and "/." not in name}
        return cls({name: ours[name].read_bytes() for name in sorted(ours)})

    @classmethod
    def of_commit(cls, checkout: Path, commit: str) -> Self:
        """The files as they were at a commit.

        Raises:
            CEIError: git does not know it, as in a shallow clone.
        """
        archive = git(checkout, "archive", "--format=tar", commit, "--", *ROOTS)
        with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
            members = {member.name: tar.extractfile(member) for member in tar if member.isfile()}
        return cls({name: file.read() for name, file in sorted(members.items()) if file is not None})

    @cached_property
    def digests(self) -> Digests:
        """The digests of all files."""
        return {path: self.digest(path) for path in self._files}

    @property
    def name(self) -> str:
        """The digest of all digests."""
        return f"code-{hashlib.sha256(json.dumps(self.digests).encode()).hexdigest()[:_DIGITS]}"

    def digest(self, path: str, renamed: Mapping[str, str] | None = None) -> str:
        """The digest of one file.

        Args:
            path: in the checkout.
            renamed: other names under which modules are taken to be imported, by those that the file has.
        """
        parts = _parts(path, self._files[path])
        text = "".join(part if isinstance(part, str) else _renamed(part, renamed or {}) for part in parts)
        return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]


def checkout() -> Path | None:
    """The checkout that cei_gym is imported from; None if it is installed without one."""
    root = Path(cei_gym.__file__).parents[1]
    return root if all((root / name).is_dir() for name in ROOTS) else None


def git(folder: Path, *args: str) -> bytes:
    """What git prints.

    Raises:
        CEIError: it fails.
    """
    try:
        return subprocess.run(["git", "-C", str(folder), *args], check=True, capture_output=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", b"").decode(errors="replace")
        raise CEIError(
            f"git {args[0]} fails ({one_line(said or str(error))}); a shallow clone lacks old commits."
        ) from error


def select(paths: Iterable[str], patterns: Iterable[str]) -> list[str]:
    """Paths of some patterns' files: `cei_gym/*` is all below a folder, `!cei_gym/wrapper.py` is left out again."""
    patterns = [*patterns]
    wanted, unwanted = ([p.removeprefix("!") for p in patterns if p.startswith("!") is not_] for not_ in (False, True))
    return [p for p in paths if any(fnmatchcase(p, w) for w in wanted) and not any(fnmatchcase(p, u) for u in unwanted)]


def changes(then: Digests, now: Code, patterns: Iterable[str]) -> list[str]:
    """Files of some patterns that are not what they were.

    A file that is new does not count by itself: what uses it has changed, too.

    Args:
        then: all code at the time.
        now: all code.
        patterns: of the files in question, see `select`.
    """
    moved = _moved(then, now)
    renamed = {_module(new): _module(old) for old, new in moved.items() if new.endswith(".py")}
    found = []
    for path in select(then, patterns):
        if path in now.digests:
            if then[path] not in (now.digests[path], now.digest(path, renamed)):
                found.append(path)
        elif path not in moved and then[path] != EMPTY:
            found.append(f"{path} (gone)")
    return found


def _moved(then: Digests, now: Code) -> dict[str, str]:
    """New path by old one, of files that are elsewhere and else unchanged; found one after the other, as they import each other."""
    moved: dict[str, str] = {}
    while True:
        renamed = {_module(new): _module(old) for old, new in moved.items()}
        new = {now.digest(path, renamed): path for path in now.digests if path not in {*then, *moved.values()}}
        gone = [path for path in then if path not in now.digests and path not in moved and then[path] != EMPTY]
        found = {path: new[then[path]] for path in gone if then[path] in new}
        if not found:
            return moved
        moved |= found


def _module(path: str) -> str:
    """Dotted name under which a file is imported."""
    parts = path.removesuffix(".py").removesuffix("/__init__").split("/")
    return ".".join(parts[1:] if parts[0] in _ABOVE_PACKAGES else parts)


# -- what a file does ---------------------------------------------------------------------------------------------------

type Imports = tuple[tuple[str, str], ...]
"""What imports that follow each other bring: dotted name, and what it is called here."""


@lru_cache(4096)
def _parts(path: str, content: bytes) -> tuple["str | Imports", ...]:
    return tuple(_read(path, content))


def _read(path: str, content: bytes) -> Iterator["str | Imports"]:
    """What counts of a file, as text, and its imports in their places."""
    try:
        if path.endswith(".py"):
            yield from _walk(ast.parse(content))
        elif path.endswith((".yaml", ".yml")):
            yield json.dumps(load_yaml(content.decode()), default=str)
        else:
            yield hashlib.sha256(content).hexdigest()
    except (SyntaxError, UnicodeDecodeError, CEIError):  # of no use, but not ours to judge
        yield hashlib.sha256(content).hexdigest()


def _walk(value: object) -> Iterator["str | Imports"]:
    """A syntax tree as text. Unlike `ast.dump`, the same from every version of Python: fields without a value are left out."""
    if isinstance(value, list):
        yield "["
        for are_imports, run in itertools.groupby(filter(_counts, value), _is_import):
            if are_imports:
                yield tuple(pair for node in run for pair in _imported(node))
            else:
                for each in run:
                    yield from _walk(each)
                    yield ","
        yield "]"
    elif isinstance(value, ast.AST):
        yield f"{type(value).__name__}("
        for name, field in ast.iter_fields(value):
            if field is not None and field != [] and name != "ctx":
                yield f"{name}="
                yield from _walk(field)
                yield ","
        yield ")"
    else:
        yield ascii(value)


def _counts(value: object) -> bool:
    """Whether a statement does something; a bare string does not."""
    if isinstance(value, ast.Expr) and isinstance(value.value, ast.Constant):
        return not isinstance(value.value.value, str)
    return True


def _is_import(value: object) -> bool:
    return isinstance(value, ast.Import | ast.ImportFrom)


def _imported(node: ast.Import | ast.ImportFrom) -> Iterator[tuple[str, str]]:
    above = "." * node.level + (node.module or "") + "." if isinstance(node, ast.ImportFrom) else ""
    for alias in node.names:
        yield f"{above}{alias.name}", alias.asname or (alias.name if above else "")


def _renamed(imports: Imports, renamed: Mapping[str, str]) -> str:
    def name(dotted: str) -> str:
        module, _, last = dotted.rpartition(".")
        return renamed.get(dotted) or (f"{renamed[module]}.{last}" if module in renamed else dotted)

    return ascii(sorted({(name(dotted), called) for dotted, called in imports}))


EMPTY = Code({"empty.py": b""}).digest("empty.py")
"""The digest of a module that does nothing."""
