"""What a command found, as JSON."""

import json
import os
from pathlib import Path
from typing import Any

from cei_converters.metadata import plain
from cei_gym.errors import CEIError


def check_json_path(path: str | None) -> None:
    """Fail before the work, not after it, if the result could not be written."""
    if path is not None and not Path(path).absolute().parent.is_dir():
        raise CEIError(f"--json={path}: there is no folder {Path(path).parent}.")


def write_json(path: str | None, result: dict[str, Any]) -> None:
    """Write a result in one go (a reader never sees half of it); nothing if no path is asked for."""
    if path is None:
        return
    target = Path(path)
    partial = target.with_name(f".{target.name}.partial-{os.getpid()}")
    partial.write_text(json.dumps(plain(result), indent=1, allow_nan=False) + "\n")
    partial.replace(target)
