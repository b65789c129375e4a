"""The names of our environments where their package is not installed, so that opening one says what it needs."""

import os
import warnings
from pathlib import Path
from typing import Any, NoReturn

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

from cei_gym import extras
from cei_gym.errors import CEIError

TASKS = (
    *("OpenDrawer", "PickCube", "StackCube"),
    *("PushCube", "PlaceBird", "PressButton", "PickCup", "PackageBread", "InsertFlower"),
    *("Pick-Sphere", "Pick-Cylinder", "Pick-LyingCylinder", "Pick-ThinBox", "Pick-Plate", "Pick-Mug", "Pick-Hammer"),
    *("Pick-Can", "Pick-Lemon", "Pick-Nut"),
    *("Lift", "Stack", "PickPlaceCan", "NutAssemblySquare", "Door"),
)
"""The tasks of `cei_envs`."""

_FOLDERS = "CEI_GYM_EMBODIMENTS"  # the catalogue's, which is not imported where nobody has robots of their own
_SPECIFICATIONS = Path(__file__).parent / "embodiment/specifications"


def register() -> None:
    """Register every `CEI-<Task>-<Arm>-<EndEffector>` that is not yet, with `unavailable` in its place. No robot is looked at."""
    arms, end_effectors = (
        sorted(path.stem for path in (_SPECIFICATIONS / part).glob("*.yaml")) for part in ("arms", "end_effectors")
    )
    robots = [f"{arm}-{hand}" for arm in arms for hand in end_effectors]
    if os.environ.get(_FOLDERS):
        from cei_gym.embodiment import embodiment_names

        try:
            robots = [name for name in embodiment_names() if name.count("-") == 1]
        except CEIError as error:
            warnings.warn(str(error), stacklevel=2)
    for name in (f"CEI-{task}-{robot}" for task in TASKS for robot in robots):
        if name not in gym.registry:
            gym.registry[name] = EnvSpec(name, unavailable, kwargs={"env_id": name})  # as cei_envs.registration has it


def unavailable(env_id: str, **_: Any) -> NoReturn:
    """Say what an environment needs; of a robot of one's own, also that it is known.

    Raises:
        MissingExtra: always.
    """
    from cei_gym.embodiment.catalogue import own_yamls

    needs = extras.lacking(env_id, "robosuite")
    robot = "-".join(env_id.rsplit("-", 2)[1:])
    if found := own_yamls(robot):
        raise extras.MissingExtra(f"{needs} {robot} itself is known: {', '.join(map(str, found))}.")
    raise needs
