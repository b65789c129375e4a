"""`cei-robot list`: the robots there are, and what each is good for."""

from dataclasses import dataclass
from pathlib import Path

from cei_converters.cli import run
from cei_converters.cli.options import check_overwrite
from cei_gym import extras
from cei_gym.errors import CEIError

EXAMPLE = """example:
  cei-robot list"""


@dataclass
class ListConfig:
    """List arms and end-effectors by their names, those that ship and your own, with what each is good for."""

    package_path: list[Path] | None = None  # Folders to look for ROS packages in, separated by colons.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace a JSON file that is there already.

    def __post_init__(self) -> None:
        check_overwrite(self.overwrite, self.json)


def list_robots(config: ListConfig) -> None:
    """Print two tables.

    Raises:
        CEIError: a file must not be replaced.
    """
    extras.require_module("cei-robot list", "rich")
    from cei_converters.cli.outputs import JSON, Outputs
    from cei_converters.cli.result import write_json
    from cei_converters.cli.table import print_table
    from cei_gym.embodiment import arm_names, end_effector_names, use_package_path

    json = Outputs(config.overwrite).file("--json", config.json, JSON)
    use_package_path(config.package_path)
    arms = [_arm(name) for name in arm_names()]
    hands = [_hand(name) for name in end_effector_names()]
    print_table(arms, "Arms")
    print_table(hands, "End-effectors")
    write_json(json, {"arms": arms, "end_effectors": hands})


def _arm(name: str) -> dict[str, object]:
    from cei_gym.embodiment import build_embodiment, load_arm
    from cei_gym.onboarding.arm import reach_m

    spec = load_arm(name)
    try:
        arm = build_embodiment(spec, None)
    except CEIError as error:
        return {"name": name, "joints": None, "reach_m": None, "remark": f"{spec.remark}; not here: {error}"}
    return {"name": name, "joints": len(arm.coupled.independent), "reach_m": reach_m(arm), "remark": spec.remark}


def _hand(name: str) -> dict[str, object]:
    from cei_gym.alignment.contact.pads import opposing_sides
    from cei_gym.embodiment import build_embodiment, load_end_effector
    from cei_gym.functional.representation import sample_representation
    from cei_gym.kinematics import KinematicTree
    from cei_gym.onboarding.check import pad_gap_m

    spec = load_end_effector(name)
    try:
        hand = build_embodiment(None, spec)
        representation = sample_representation(hand)
    except CEIError as error:
        return {
            "name": name,
            "motors": None,
            "pads": None,
            "opens_mm": None,
            "remark": f"{spec.remark}; not here: {error}",
        }
    sides = opposing_sides(representation, KinematicTree(hand))
    opens = None if sides is None else round(1e3 * float(pad_gap_m(representation, sides).max()))
    return {
        "name": name,
        "motors": len(hand.coupled.independent),
        "pads": str(len(spec.pads)),
        "opens_mm": opens,
        "remark": spec.remark,
    }


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-robot list`."""
    return run(ListConfig, list_robots, args, prog="cei-robot list", example=EXAMPLE)
