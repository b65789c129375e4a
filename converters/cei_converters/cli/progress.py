"""One progress bar for every command: what, how many, time spent and left; silent where there is no terminal."""

import contextlib
from collections.abc import Generator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from cei_converters import signals


@contextlib.contextmanager
def progress_bar(unit: str) -> Generator[Progress]:
    """A progress bar that counts `unit`s. However the block ends, the terminal has its cursor back."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    with signals.unfinished(progress.stop), progress:
        yield progress
