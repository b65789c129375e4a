"""What `cei-benchmark real`, `anchors` and `modes` share: their stages, the checks of their options, how they end."""

import sys
from collections.abc import Iterable, Sequence
from typing import Any

from cei_converters.cli.options import check_range
from cei_gym.embodiment import load_embodiment
from cei_gym.embodiment.resources import PACKAGE_PATH
from cei_gym.errors import CEIError, unknown

STAGES = ("all", "replay", "policy", "train", "evaluate")


def check_staged(config: Any, *counts: str, running: Sequence[str] = ("jobs", "stage")) -> None:
    """Check a benchmark's options.

    Args:
        config: with `stage`, `seed`, `jobs` and `redraw`.
        counts: names of those that are at least 1.
        running: names of those that are about running, which `redraw` does not.

    Raises:
        CEIError: one is wrong.
    """
    if config.stage not in STAGES:
        raise unknown("--stage", config.stage, STAGES)
    for name in (*counts, "jobs"):
        check_range(f"--{name}", getattr(config, name), 1)
    check_range("--seed", config.seed, 0)
    if config.redraw and any(getattr(config, name) != getattr(type(config), name) for name in running):
        *others, last = (f"--{name}" for name in running)
        raise CEIError(f"--redraw runs nothing; leave out {', '.join(others)} and {last}.")


def replays(stage: str) -> bool:
    """Whether demonstrations are to be replayed."""
    return stage in ("all", "replay")


def policies(stage: str) -> str | None:
    """How far to go with policies, one of `training.STAGES`; None for nowhere."""
    return {"replay": None, "policy": "all"}.get(stage, stage)


def check_robots(robots: Iterable[str]) -> None:
    """Check that robots' descriptions are there, before the work.

    Raises:
        CEIError: one is not.
    """
    for robot in dict.fromkeys(robots):
        try:
            load_embodiment(robot)
        except CEIError as error:
            raise CEIError(f"{robot}: {error} Here the folder is what {PACKAGE_PATH} names.") from error


def print_errors(errors: Iterable[str]) -> None:
    """Print what went wrong, a line each."""
    for error in errors:
        print(f"error: {error}", file=sys.stderr)


def conclude(errors: Sequence[str]) -> None:
    """End.

    Raises:
        CEIError: something went wrong.
    """
    if errors:
        raise CEIError(f"{len(errors)} failed, see above; the same command runs them again.")
