"""Two constants of LeRobot's, whose import would take two seconds for torch's sake: where it keeps datasets, and in which format."""

import os
from pathlib import Path

CODEBASE_VERSION = "v3.0"
"""The format that is read and written."""


def lerobot_home() -> Path:
    """LeRobot's `HF_LEROBOT_HOME`."""
    from huggingface_hub.constants import HF_HOME

    return Path(os.getenv("HF_LEROBOT_HOME", Path(HF_HOME) / "lerobot")).expanduser()
