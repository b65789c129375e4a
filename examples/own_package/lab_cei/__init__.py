"""A lab's own additions to CEI-Gym; see `pyproject.toml` for how they are found."""
