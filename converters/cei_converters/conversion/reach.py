"""The refusal of episodes that the target does not follow."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from cei_gym.errors import CEIError

_SPANS, _EPISODES = 5, 3  # shown; more are counted


def check_reached(target: str, entries: Sequence[dict[str, Any]]) -> None:
    """Check that the target follows in every frame.

    Args:
        target: embodiment.
        entries: per episode `episode`, and maybe `unreachable_frames` and why (`unreachable_because`).

    Raises:
        CEIError: naming the episodes and frames in which it does not, and why.
    """
    missed = [entry for entry in entries if entry.get("unreachable_frames")]
    if not missed:
        return
    told = [f"episode {e['episode']}, {spans(e['unreachable_frames'])}: {_why(e)}" for e in missed[:_EPISODES]]
    more = f" And {len(missed) - _EPISODES} more episodes." if len(missed) > _EPISODES else ""
    raise CEIError(
        f"{target} does not follow the source in {' '.join(told)}{more} Or leave out episodes with --episodes, keep them with "
        "--allow_unreachable, or accept pads that are farther away with --transfer.unreachable_mm."
    )


def _why(entry: dict[str, Any]) -> str:
    return str(entry.get("unreachable_because") or "its pads are too far away.")


def spans(frames: Sequence[int], of: str = "frame") -> str:
    """Frames, or what else is counted, in words: `frame 3`, or `frames 0-12, 40`."""
    ends = [i for i, (a, b) in enumerate(pairwise(frames)) if b != a + 1]
    runs = zip([0, *(i + 1 for i in ends)], [*ends, len(frames) - 1], strict=True)
    named = [f"{frames[a]}-{frames[b]}" if a < b else str(frames[a]) for a, b in runs]
    more = f" and {len(named) - _SPANS} more spans" if len(named) > _SPANS else ""
    return f"{of}{'s' if len(frames) > 1 else ''} {', '.join(named[:_SPANS])}{more}"
