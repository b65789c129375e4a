"""Tables on the terminal."""

import math
import sys
from collections.abc import Sequence
from typing import Any, cast

# a pipe has no width; wide enough for every column on one line
PIPE_WIDTH = 180


def print_table(entries: list[dict[str, Any]], title: str) -> None:
    """Print one row an episode; lists appear as their length."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if not console.is_terminal:
        console = Console(width=PIPE_WIDTH)
    names = list(dict.fromkeys(name for entry in entries for name in entry))
    table = Table(title=title)
    for name in names:
        table.add_column(name.replace("_", " "), justify="right", overflow="fold")
    for entry in entries:
        table.add_row(*(_cell(entry.get(name)) for name in names))
    console.print(table)


def print_markdown(text: str) -> None:
    """Print a document for people to read."""
    from rich.console import Console
    from rich.markdown import Markdown

    Console(width=None if sys.stdout.isatty() else PIPE_WIDTH).print(Markdown(text))


def _cell(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return str(len(cast(Sequence[object], value))) if value else "-"
    if isinstance(value, float):
        return f"{value:.3g}" if math.isfinite(value) else "-"
    return "-" if value is None else str(value)
