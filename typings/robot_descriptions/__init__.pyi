"""What this project uses of robot_descriptions, which ships no types."""

from typing import Any

class Description:
    repository: str | None
    formats: Any

DESCRIPTIONS: dict[str, Description]
