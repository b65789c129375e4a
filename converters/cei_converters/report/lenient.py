"""Entries of a dataset's records, which may be a stranger's: as what they should be, or as nothing."""

from collections.abc import Mapping
from math import isfinite
from typing import Any


def mapping(value: object) -> Mapping[str, Any]:
    """It, if it is one; else an empty one."""
    return value if isinstance(value, dict) else {}


def number(value: object) -> float | None:
    """It, if it is a finite number; else None."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not isfinite(value):
        return None
    return float(value)


def share(value: object) -> float | None:
    """It, if it is a number in [0, 1]; else None."""
    found = number(value)
    return found if found is not None and 0 <= found <= 1 else None
