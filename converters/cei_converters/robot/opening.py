"""A robot of which only one name is given: an arm, an end-effector, both, or a YAML of either."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from cei_converters.cli.values import home_expanded
from cei_gym.embodiment import (
    ArmSpec,
    Embodiment,
    EndEffectorSpec,
    arm_names,
    build_embodiment,
    embodiment_names,
    end_effector_names,
    load_arm,
    load_embodiment,
    load_end_effector,
    load_spec,
)
from cei_gym.errors import CEIError, one_line, unknown
from cei_gym.untrusted import load_yaml


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
    """Build a robot.

    Args:
        robot: name of an arm, of an end-effector, `<Arm>-<EndEffector>`, or path of a YAML (`.yaml`, `.yml`) of an arm or an
            end-effector.

    Raises:
        CEIError: there is no such robot, or it cannot be built.
    """
    if robot.lower().endswith((".yaml", ".yml")):
        return _of_file(Path(home_expanded("--robot", robot)))
    if robot in arm_names():
        return Robot(build_embodiment(load_arm(robot), None))
    if robot in end_effector_names():
        return _with_file(build_embodiment(None, load_end_effector(robot)))
    if robot in embodiment_names():
        return _with_file(load_embodiment(robot))
    raise unknown("robot", robot, [*arm_names(), *end_effector_names(), *embodiment_names()])


def _of_file(path: Path) -> Robot:
    try:
        raw = load_yaml(path.read_text())
    except FileNotFoundError:
        raise CEIError(f"no such file: {path}.") from None
    except (OSError, ValueError) as error:
        raise CEIError(f"{path} cannot be read: {one_line(error)}.") from error
    keys = cast(Mapping[str, object], raw) if isinstance(raw, Mapping) else {}
    if "mount_body" in keys:
        return Robot(build_embodiment(load_spec(ArmSpec, path), None))
    if "pads" in keys:
        return Robot(build_embodiment(None, load_spec(EndEffectorSpec, path)), path)
    raise CEIError(f"{path} is no robot: an arm's YAML has a `mount_body`, an end-effector's has `pads`.")


def _with_file(embodiment: Embodiment) -> Robot:
    spec = embodiment.end_effector
    assert spec is not None
    return Robot(embodiment, Path(spec.folder) / f"{spec.name}.yaml")
