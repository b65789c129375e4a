"""Robots of others, in ../shared, for tests that use them."""

from pathlib import Path

import pytest

SHARED = Path(__file__).parents[2] / "shared"

needs_robots = pytest.mark.skipif(
    not (SHARED / "robots").is_dir(), reason="third-party descriptions are not in ../shared/robots"
)
