"""Pieces of a card."""

from collections.abc import Iterable
from typing import Any


def markdown_table(header: tuple[str, ...], rows: list[tuple[Any, ...]]) -> str:
    """A table in Markdown."""
    lines = [header, tuple("---" for _ in header), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)


def listed(names: Iterable[str]) -> str:
    """Names, one after the other, as code."""
    return ", ".join(f"`{name}`" for name in names)


def flat(options: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Options of options by dotted names."""
    found: list[tuple[str, Any]] = []
    for name, value in options.items():
        if isinstance(value, dict):
            found += flat(value, f"{prefix}{name}.")
        else:
            found.append((prefix + name, value))
    return found
