"""A robot of which only one name is given: an arm, an end-effector, both, or a YAML of either."""

from dataclasses import dataclass
from pathlib import Path

from cei_converters.cli.values import home_expanded
from cei_converters.robot.findings import parts_of
from cei_gym.embodiment import ArmSpec, Embodiment, EndEffectorSpec, build_embodiment


@dataclass(frozen=True)
class Robot:
    """A robot that was opened.

    Attributes:
        embodiment: an arm, an end-effector or both.
        end_effector_file: the end-effector's YAML, if it has one.
    """

    embodiment: Embodiment
    end_effector_file: Path | None = None


def open_robot(robot: str) -> Robot:
    """Build a robot that goes by a name, or a YAML's path; see `parts_of`.

    Raises:
        CEIError: there is no such robot, or it cannot be built.
    """
    file = Path(home_expanded("--robot", robot)) if robot.lower().endswith((".yaml", ".yml")) else None
    parts = parts_of(robot if file is None else str(file))
    arm = next((part for part in parts if isinstance(part, ArmSpec)), None)
    end_effector = next((part for part in parts if isinstance(part, EndEffectorSpec)), None)
    embodiment = build_embodiment(arm, end_effector)
    if end_effector is None:
        return Robot(embodiment)
    return Robot(embodiment, file or Path(end_effector.folder) / f"{end_effector.name}.yaml")
