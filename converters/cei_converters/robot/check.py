"""`cei-robot check`: what is wrong with a robot's YAML."""

from dataclasses import dataclass
from pathlib import Path

from cei_converters.cli import run
from cei_converters.cli.options import check_overwrite
from cei_gym.errors import CEIError

EXAMPLE = """examples:
  cei-robot check embodiments/end_effectors/MyHand.yaml
  cei-robot check UR5e-Inspire"""


@dataclass
class CheckConfig:
    """Say in plain words what is wrong with an arm, an end-effector or both."""

    robot: str  # Name of an arm, an end-effector or <Arm>-<EndEffector>, or a YAML.
    package_path: list[Path] | None = None  # Folders to look for ROS packages in, separated by colons.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace a JSON file that is there already.

    def __post_init__(self) -> None:
        check_overwrite(self.overwrite, self.json)


def check(config: CheckConfig) -> None:
    """Print what is wrong and what is worth a look.

    Raises:
        CEIError: something is wrong.
    """
    from cei_converters.cli.outputs import JSON, Outputs
    from cei_converters.cli.result import write_json
    from cei_converters.robot.findings import of_spec, parts_of, print_findings
    from cei_gym.embodiment import use_package_path

    json = Outputs(config.overwrite).file("--json", config.json, JSON)
    use_package_path(config.package_path)
    result: dict[str, list[dict[str, object]]] = {}
    for spec in parts_of(config.robot):
        findings = of_spec(spec)
        print(f"{spec.name}:")
        print_findings(findings)
        result[spec.name] = [{"wrong": finding.wrong, "text": finding.text} for finding in findings]
    write_json(json, result)
    wrong = {name: sum(bool(finding["wrong"]) for finding in findings) for name, findings in result.items()}
    if any(wrong.values()):
        raise CEIError(
            f"{', '.join(f'{count} of {name}' for name, count in wrong.items() if count)} to be mended, see above."
        )


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-robot check`."""
    return run(CheckConfig, check, args, prog="cei-robot check", example=EXAMPLE)
