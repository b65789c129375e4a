"""Quality of converted episodes: the table on the terminal, and the refusal of unreachable ones."""

import math
from typing import Any

from cei_gym.errors import CEIError

SHOWN_FRAMES = 10
# a pipe has no width; wide enough for every column on one line
PIPE_WIDTH = 180


def check_reached(target: str, entries: list[dict[str, Any]]) -> None:
    """Check that the target reaches every frame.

    Args:
        target: embodiment.
        entries: per episode `episode` and maybe `unreachable_frames`.

    Raises:
        CEIError: naming the episodes and frames that it does not reach.
    """
    missed = [entry for entry in entries if entry.get("unreachable_frames")]
    if missed:
        named = "; ".join(f"episode {e['episode']}: {_frames(e['unreachable_frames'])}" for e in missed)
        raise CEIError(
            f"{target} cannot reach {named}; leave these episodes out with --episodes, change --transfer.*, "
            "or keep them with --allow_unreachable."
        )


def _frames(frames: list[int]) -> str:
    shown = ", ".join(map(str, frames[:SHOWN_FRAMES]))
    more = f" and {len(frames) - SHOWN_FRAMES} more" if len(frames) > SHOWN_FRAMES else ""
    return f"frame{'s' if len(frames) > 1 else ''} {shown}{more}"


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


def _cell(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return str(len(value)) if value else "-"
    if isinstance(value, float):
        return f"{value:.3g}" if math.isfinite(value) else "-"
    return "-" if value is None else str(value)
