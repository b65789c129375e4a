"""What is wrong with a robot, as it is told."""

from collections.abc import Sequence
from pathlib import Path

from cei_gym.embodiment import ArmSpec, EndEffectorSpec
from cei_gym.embodiment.catalogue import arm_names, end_effector_names, load_arm, load_end_effector, load_part
from cei_gym.errors import CEIError, unknown
from cei_gym.onboarding import Finding, check_arm, check_end_effector


def parts_of(robot: str) -> list[ArmSpec | EndEffectorSpec]:
    """Specifications of a YAML, of an arm, of an end-effector, or of both of `<Arm>-<EndEffector>`.

    Raises:
        CEIError: there is none of that name, or its YAML is wrong.
    """
    if robot.lower().endswith((".yaml", ".yml")):
        return [load_part(Path(robot).expanduser())]
    arm, hyphen, end_effector = robot.partition("-")
    if hyphen:
        return [load_arm(arm), load_end_effector(end_effector)]
    if robot in arm_names():
        return [load_arm(robot)]
    if robot in end_effector_names():
        return [load_end_effector(robot)]
    raise unknown("robot", robot, [*arm_names(), *end_effector_names()])


def of_spec(spec: ArmSpec | EndEffectorSpec) -> list[Finding]:
    """What is to say of an arm or an end-effector."""
    return check_arm(spec) if isinstance(spec, ArmSpec) else check_end_effector(spec)


def of_yaml(path: Path, name: str) -> list[Finding]:
    """What is to say of a YAML that will be called `name`; that it cannot be read, at least."""
    try:
        return of_spec(load_part(path))
    except CEIError as error:
        return [Finding(True, str(error).replace(path.name, name))]


def print_findings(findings: Sequence[Finding]) -> None:
    """What is wrong first, then what is worth a look."""
    for finding in findings:
        print(f"  {'WRONG' if finding.wrong else 'note'}: {finding.text}")
    if not any(finding.wrong for finding in findings):
        print("  Nothing is wrong with it.")
