"""Marks in documents: beside each figure the commit that it was measured at, and whether it is older than the code.

A mark stands between two comments, of which the first names a figure's file, or a folder of figures, as a link would:

    <!-- measured results/replay/replay.csv -->(`c0986c0`, older than the code)<!-- end -->

A document never says that a figure is up to date: the code may change without it. The commit is true whatever happens.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from cei_converters.benchmark.ages import Aged, shortened
from cei_gym.errors import CEIError

OLDER = ", older than the code"
NOT_OURS = ("build", "dist", "outputs", "data", "node_modules")
"""Folders of a checkout whose documents are not the project's; as in tests/smoke/documents.py, which imports nothing of ours."""
_MARK = re.compile(r"<!-- measured (\S+) -->(.*?)<!-- end -->", re.DOTALL)
_FENCED = re.compile(r"^ *(```+|~~~+).*?^ *\1 *$", re.DOTALL | re.MULTILINE)


def documents(root: Path) -> list[Path]:
    """All Markdown of a checkout, but for what is hidden."""
    folders = [path for path in root.iterdir() if path.is_dir() and path.name not in NOT_OURS and path.name[0] != "."]
    return sorted({*root.glob("*.md"), *(path for folder in folders for path in folder.rglob("*.md"))})


def marked(document: Path, aged: Sequence[Aged]) -> str:
    """A document's text with its marks as they should be.

    Args:
        document: Markdown.
        aged: all figures.

    Raises:
        CEIError: a mark names no figure.
    """
    text = document.read_text()
    fenced = [found.span() for found in _FENCED.finditer(text)]

    def new(mark: re.Match) -> str:
        if any(start <= mark.start() < end for start, end in fenced):
            return mark.group()
        found = _named(document, mark[1], aged)
        commits = [commit for each in found for commit in each.commits]
        return mark_of(mark[1], commits, any(each.is_older for each in found))

    return _MARK.sub(new, text)


def mark_of(name: str, commits: Iterable[str], is_older: bool = False) -> str:
    """A mark.

    Args:
        name: of the figure's file, or of its folder, as the document would link it.
        commits: that it was measured at.
        is_older: whether it is older than the code.
    """
    short = dict.fromkeys(f"`{shortened(commit)}`" for commit in commits)
    return f"<!-- measured {name} -->({', '.join(short)}{OLDER if is_older else ''})<!-- end -->"


def figures_of(document: Path, aged: Sequence[Aged]) -> list[Aged]:
    """The figures that a document's marks name.

    Raises:
        CEIError: a mark names no figure.
    """
    text = _FENCED.sub("", document.read_text())
    return [each for mark in _MARK.finditer(text) for each in _named(document, mark[1], aged)]


def _named(document: Path, name: str, aged: Sequence[Aged]) -> list[Aged]:
    path = (document.parent / name).resolve()
    found = [
        each
        for each in aged
        if path == each.folder.resolve() or (path.parent == each.folder.resolve() and each.figure.has(path.name))
    ]
    if not found:
        raise CEIError(f"{document}: '{name}' in a mark is no figure and no folder of figures.")
    return found
