"""The names of our environments where their package is not installed, so that opening one says what it needs."""

from pathlib import Path
from typing import Any, NoReturn

import gymnasium as gym

from cei_gym import extras

TASKS = ("OpenDrawer", "PickCube", "StackCube")
"""The tasks of `cei_envs`."""

_SPECIFICATIONS = Path(__file__).parent / "embodiment/specifications"


def register() -> None:
    """Register every `CEI-<Task>-<Arm>-<EndEffector>`, with `unavailable` in its place. No robot is looked at."""
    arms, end_effectors = (
        sorted(path.stem for path in (_SPECIFICATIONS / part).glob("*.yaml")) for part in ("arms", "end_effectors")
    )
    for name in (f"CEI-{task}-{arm}-{hand}" for task in TASKS for arm in arms for hand in end_effectors):
        if name not in gym.registry:
            gym.register(name, unavailable, kwargs={"env_id": name})


def unavailable(env_id: str, **_: Any) -> NoReturn:
    """Say what an environment needs.

    Raises:
        MissingExtra: always.
    """
    raise extras.lacking(env_id, "robosuite")
