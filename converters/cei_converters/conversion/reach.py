"""The refusal of episodes that the target cannot reach."""

from typing import Any

from cei_gym.errors import CEIError

SHOWN_FRAMES = 10


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
