"""What a step says of success and failure."""

from typing import Any


def outcome(info: dict[str, Any]) -> dict[str, Any]:
    """An environment's `info`, less how long the step took, which is 0 as it is reset."""
    assert info["step_time_s"] >= 0
    return {key: value for key, value in info.items() if key != "step_time_s"}
