"""The embodiments that ship: four arms x five end-effectors, each one YAML beside this file."""

from functools import cache
from pathlib import Path

from cei_gym.embodiment.embodiment import Embodiment, build_embodiment
from cei_gym.embodiment.spec import ArmSpec, EndEffectorSpec, load_spec
from cei_gym.errors import unknown

ARMS = ("UR5e", "IIWA", "Kinova3", "Panda")
END_EFFECTORS = ("FourierRight", "Inspire", "FourierLeft", "RobotiqThreeFinger", "PandaGripper")

_FOLDER = Path(__file__).parent / "specifications"


def embodiment_names() -> list[str]:
    """All `<Arm>-<EndEffector>` names of the catalogue."""
    return [f"{arm}-{end_effector}" for arm in ARMS for end_effector in END_EFFECTORS]


def load_arm(name: str) -> ArmSpec:
    """Specification of a catalogued arm."""
    if name not in ARMS:
        raise unknown("arm", name, ARMS)
    return load_spec(ArmSpec, _FOLDER / "arms" / f"{name}.yaml")


def load_end_effector(name: str) -> EndEffectorSpec:
    """Specification of a catalogued end-effector."""
    if name not in END_EFFECTORS:
        raise unknown("end-effector", name, END_EFFECTORS)
    return load_spec(EndEffectorSpec, _FOLDER / "end_effectors" / f"{name}.yaml")


@cache
def load_embodiment(name: str) -> Embodiment:
    """Build a catalogued embodiment (compiled once a process; treat it as read-only).

    Raises:
        CEIError: no such name (the message lists the valid ones), or its description is not installed.
    """
    if name not in embodiment_names():
        raise unknown("embodiment", name, embodiment_names())
    arm, end_effector = name.split("-")
    return build_embodiment(load_arm(arm), load_end_effector(end_effector))
