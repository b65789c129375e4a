"""Hidden files beside a dataset's (`._file-000.parquet` of a Mac, `.DS_Store`): they are not data."""

from pathlib import Path


def hidden(path: Path, root: Path | None = None) -> bool:
    """Whether a file is hidden by its name, or by that of a folder that it is in below `root`."""
    parts = (path.name,) if root is None else path.relative_to(root).parts
    return any(part.startswith(".") for part in parts)


def visible(root: Path, pattern: str) -> list[Path]:
    """Files below a folder that a pattern matches and that are not hidden, in order."""
    return sorted(path for path in root.glob(pattern) if not hidden(path, root))


def link_visible(folder: Path, to: Path) -> None:
    """Make a folder with links to all files of another, however deep, but for those that are hidden or in a hidden folder."""
    to.mkdir(parents=True)
    for entry in folder.iterdir():
        if hidden(entry):
            continue
        if entry.is_dir():
            link_visible(entry, to / entry.name)
        else:
            (to / entry.name).symlink_to(entry.resolve())
