"""`cei-robot new`: a YAML from a robot's description."""

import os
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from cei_converters import signals
from cei_converters.cli import run
from cei_gym import extras
from cei_gym.errors import CEIError

EXAMPLE = """examples:
  cei-robot new robots/my_arm.urdf
  cei-robot new robots/my_hand.urdf --as=end_effector --name=MyHand
  cei-robot new package://my_description/urdf/robot.urdf --package_path=robots --output=embodiments"""


@dataclass
class NewConfig:
    """Write the YAML of an arm, an end-effector or both from a MJCF or URDF: a guess that `cei-robot check` and `show` look at."""

    description: (
        str  # The MJCF, URDF or xacro: a path, package://..., robot_descriptions:NAME or mujoco_menagerie:NAME.
    )
    as_: str = ""  # arm, end_effector or both; default: found out.
    name: str = ""  # What it will be called; default: after the file.
    root: str = ""  # Link to begin at, of a file with more in it; default: the first.
    output: Path | None = (
        None  # Folder of your embodiments; default: the first of CEI_GYM_EMBODIMENTS, else embodiments/.
    )
    xacro_args: list[str] | None = None  # Arguments of a xacro, such as [prefix:=left_,limited:=true].
    package_path: list[Path] | None = None  # Folders to look for ROS packages in, separated by colons.
    overwrite: bool = False  # Replace YAMLs that are there already.


def new(config: NewConfig) -> None:
    """Write the YAMLs.

    Raises:
        CEIError: the description is refused, holds nothing of that kind, or a YAML is there already.
    """
    extras.require_module("cei-robot new", "rich")
    from cei_converters.cli.outputs import JOINT_MAP, Output, Outputs
    from cei_converters.robot.findings import of_yaml, print_findings
    from cei_gym.embodiment import use_package_path
    from cei_gym.embodiment.catalogue import FOLDERS
    from cei_gym.onboarding import propose
    from cei_gym.onboarding.propose import with_description
    from cei_gym.onboarding.writing import yaml_of

    use_package_path(config.package_path)
    first = next(filter(None, os.environ.get(FOLDERS, "").split(os.pathsep)), "embodiments")
    folder = config.output or Path(first)
    print(f"Reading {config.description} ...", flush=True)
    outputs = Outputs(config.overwrite)
    files: dict[str, Output] = {}

    def make_room(named: list[tuple[str, str]]) -> None:
        for kind, name in named:
            file = outputs.file("--output", folder / f"{kind}s" / f"{name}.yaml", JOINT_MAP)
            assert file is not None
            files[name] = file

    arguments = _arguments(config.xacro_args or [])
    proposals = propose(
        config.description, Path.cwd(), config.as_, config.name, config.root, arguments, named=make_room
    )
    with ExitStack() as unpublished:
        for proposal in proposals:
            file = files[proposal.spec.name]
            partial = unpublished.enter_context(file.whole())
            described = with_description(proposal, _from(file.path.parent, config.description))
            partial.write_text(yaml_of(described))
            findings = of_yaml(partial, file.path.name)
            _tell(file.path, proposal.spec, proposal.embodiment, proposal.unsure, proposal.notes)
            print_findings(findings)
        with signals.held():  # all of them or none: what takes its time is done
            unpublished.close()
    names = [proposal.spec.name for proposal in proposals]
    print(f"\nWrote {' and '.join(str(files[name]) for name in names)}.")
    print(f"Look at it: cei-robot show {files[names[0]]}")
    if str(folder) not in os.environ.get(FOLDERS, "").split(os.pathsep):
        print(f"To use {' and '.join(names)} by name: export {FOLDERS}={folder.resolve()}")


def _arguments(given: list[str]) -> dict[str, str]:
    """Arguments of a xacro, written as `roslaunch` has them."""
    arguments: dict[str, str] = {}
    for each in given:
        name, assigned, value = each.partition(":=")
        if not (name and assigned):
            raise CEIError(f"--xacro_args: {each!r} should read name:=value.")
        arguments[name] = value
    return arguments


def _from(folder: Path, description: str) -> str:
    """A description as a YAML in `folder` names it."""
    if ":" in description.partition("/")[0]:
        return description
    path = Path(description).expanduser().resolve()
    common = Path(os.path.commonpath([path, folder.resolve()]))
    # A relative one travels with its folder, if they have one in common.
    return os.path.relpath(path, folder.resolve()) if len(common.parts) > 2 else str(path)


def _tell(path: Path, spec, embodiment, unsure: dict[str, str], notes: list[str]) -> None:
    from cei_converters.cli.table import print_table
    from cei_gym.embodiment import ArmSpec

    print(f"\n{path}")
    rows = zip(
        embodiment.joint_names, embodiment.lower, embodiment.upper, embodiment.home, embodiment.closed,
        embodiment.max_velocity, embodiment.joint_units, strict=True,
    )  # fmt: skip
    table = [
        {"joint": name, "from": float(low), "to": float(high), "home": float(home), "closed": float(closed), "speed": float(speed), "unit": unit}
        for name, low, high, home, closed, speed, unit in rows
    ]  # fmt: skip
    print_table(table, "Its joints")
    print(f"  links: {', '.join(embodiment.link_names[1:])}")
    ends = [spec.mount_body] if isinstance(spec, ArmSpec) else [pad.body for pad in spec.pads]
    print(f"  {'its flange' if isinstance(spec, ArmSpec) else 'fingertips with pads'}: {', '.join(ends)}")
    for field, why in unsure.items():
        print(f"  unsure of {field}: {why}")
    for note in notes:
        print(f"  {note}")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-robot new`."""
    return run(NewConfig, new, args, prog="cei-robot new", example=EXAMPLE)
