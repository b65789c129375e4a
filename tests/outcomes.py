"""What a step says of success and failure."""

from typing import Any


def outcome(info: dict[str, Any]) -> dict[str, Any]:
    """An environment's `info`, less how long the step took; nothing else is in it."""
    took_s = info.get("step_time_s", 0.05)
    assert took_s > 0
    return {key: value for key, value in info.items() if key != "step_time_s"}
