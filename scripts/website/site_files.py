"""Which files the site has: every document, and what documents show or lead to; and a page for each folder that has none."""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files, InclusionLevel

from cei_converters.benchmark.marks import documents

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("docs", "results", "examples")
"""All that is in them is on the site, so that links to data and code lead somewhere."""
_PAGE = "README.md"


def collect(config: MkDocsConfig) -> list[File]:
    """Collect the files of a site that is made from this checkout."""
    found = [*documents(ROOT), *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if _shown(path))]
    paths = sorted({path.relative_to(ROOT).as_posix() for path in found} | {"LICENSE"})
    files = [File.generated(config, path, abs_src_path=str(ROOT / path)) for path in paths]
    for folder in sorted({posixpath.dirname(path) for path in paths if path.startswith(FOLDERS)}):
        if f"{folder}/{_PAGE}" not in paths:
            inside = [path for path in paths if posixpath.dirname(path) == folder]
            lines = [f"- [{name}]({name})" for name in map(posixpath.basename, inside)]
            text = "\n".join([f"# {folder}", "", *lines, ""])
            files.append(File.generated(config, f"{folder}/{_PAGE}", content=text, inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def link_pages(markdown: str, src_uri: str, files: Files) -> str:
    """A document whose links to folders lead to their pages, as they do on GitHub."""

    def lead(found: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(src_uri), found[1]))
        page = files.get_file_from_path(f"{target}/{_PAGE}")
        return found[0] if page is None else f"]({found[1].rstrip('/')}/{_PAGE})"

    return re.sub(r"\]\(([^)\s#:]+)\)", lead, markdown)


def _shown(path: Path) -> bool:
    inside = path.relative_to(ROOT).parts
    return path.is_file() and not any(part.startswith(".") or part == "__pycache__" for part in inside)
