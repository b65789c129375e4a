"""Licenses: carried over from a dataset to what is made of it, as they are; never invented."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cei_gym.untrusted import load_yaml

CARD_PATH = "README.md"
FIELDS = ("license", "license_name", "license_link")
"""Of a card, about its license."""
_FILES = tuple(f"{name}{suffix}" for name in ("LICENSE", "NOTICE") for suffix in ("", ".txt", ".md"))


def source_license(root: Path) -> dict[str, Any]:
    """What a dataset's own card says of its license, by the names in FIELDS; empty if it says nothing."""
    path = root / CARD_PATH
    if not path.is_file():
        return {}
    try:
        _, head, _ = path.read_text().split("---\n", 2)
        data = load_yaml(head)
    except ValueError:  # CEIError, too: a broken card is the source's affair
        return {}
    return {name: data[name] for name in FIELDS if name in data} if isinstance(data, dict) else {}


def license_files(root: Path) -> list[Path]:
    """A dataset's files with the text of its license."""
    return [root / name for name in _FILES if own_file(root, root / name)]


def copy_license_files(root: Path, to: Path) -> None:
    """Copy them beside what was made of the dataset."""
    for path in license_files(root):
        shutil.copyfile(path, to / path.name)


def merge_license_files(parts: Sequence[tuple[str, Path]], to: Path) -> None:
    """Copy those of several datasets beside what was put together of them; texts that differ stand one after the other.

    Args:
        parts: name and folder of each dataset.
        to: folder for the files.
    """
    texts: dict[str, dict[bytes, str]] = {}
    for name, root in parts:
        for path in license_files(root):
            texts.setdefault(path.name, {}).setdefault(path.read_bytes(), name)
    for file, found in texts.items():
        if len(found) == 1:
            (to / file).write_bytes(*found)
        else:
            whole = (f"==== {name} ====\n\n".encode() + text.rstrip() + b"\n" for text, name in found.items())
            (to / file).write_bytes(b"\n".join(whole))


def own_file(root: Path, path: Path) -> bool:
    """Whether a file is a dataset's, and no link to somebody's else. Those of the hub's cache are links to its blobs."""
    home = root.resolve()
    if home.parent.name == "snapshots":
        home = home.parents[1]
    return path.is_file() and path.resolve().is_relative_to(home)
