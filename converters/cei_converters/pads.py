"""`cei-pads`: a picture of any end-effector with its pads' points and normals."""

from dataclasses import dataclass
from pathlib import Path

from cei_converters.cli import run
from cei_converters.cli.options import check_range
from cei_converters.cli.values import home_expanded
from cei_gym.errors import unknown

EXAMPLE = """example:
  cei-pads --end_effector=Inspire --output=inspire.png
  cei-pads --end_effector=my_hand.yaml --pose=closed --output=my_hand.png"""
POSES = ("home", "half", "closed")


@dataclass
class PadsConfig:
    """Draw an end-effector with its functional representation: its pads' points and outward normals."""

    end_effector: str  # Catalogue name, or a YAML of your own.
    output: Path  # PNG to write.
    pose: str = "half"  # home, half (half closed) or closed.
    points: int = 128  # Point-normal pairs in all.
    seed: int = 0  # Of the sampling.
    frames: bool = False  # Draw the frames of the flange, of the first link and, small, of pads' links.
    package_path: list[Path] | None = None  # Folders to look for ROS packages in, separated by colons.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace files that are there already.

    def __post_init__(self) -> None:
        if self.pose not in POSES:
            raise unknown("pose", self.pose, POSES)
        check_range("--points", self.points, 1, 1_000_000)
        check_range("--seed", self.seed, 0)


def draw(config: PadsConfig) -> None:
    """Write the picture.

    Raises:
        CEIError: no such end-effector, or a file that must not be replaced.
    """
    from PIL import Image

    from cei_converters.cli.outputs import ASKED_PICTURE, JSON, Outputs
    from cei_converters.cli.result import write_json
    from cei_gym.embodiment import EndEffectorSpec, build_embodiment, load_end_effector, load_spec, use_package_path
    from cei_gym.functional.picture import draw_representation
    from cei_gym.functional.representation import sample_representation

    outputs = Outputs(config.overwrite)
    output, json = outputs.file("--output", config.output, ASKED_PICTURE), outputs.file("--json", config.json, JSON)
    assert output is not None
    use_package_path(config.package_path)
    if config.end_effector.lower().endswith((".yaml", ".yml")):
        path = Path(home_expanded("--end_effector", config.end_effector))
        embodiment = build_embodiment(None, load_spec(EndEffectorSpec, path), path.parent)
    else:
        embodiment = build_embodiment(None, load_end_effector(config.end_effector))
    representation = sample_representation(embodiment, config.points, config.seed)
    share = POSES.index(config.pose) / 2
    qpos = (1 - share) * embodiment.home + share * embodiment.closed
    picture = draw_representation(representation, qpos, config.frames)
    with output.whole() as partial:
        Image.fromarray(picture).save(partial, format="PNG")
    names = [embodiment.body_names[body].split("/")[-1] for body in representation.body]
    pads = {name: names.count(name) for name in dict.fromkeys(names)}
    notes = list(embodiment.notes)
    write_json(json, {"end_effector": embodiment.name, "output": str(output), "pads": pads, "notes": notes})
    for note in notes:
        print(f"note: {note}")
    print(f"Wrote {output}: " + ", ".join(f"{count} points on {link}" for link, count in pads.items()) + ".")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-pads`."""
    return run(PadsConfig, draw, args, prog="cei-pads", example=EXAMPLE)


if __name__ == "__main__":
    from cei_converters import start

    raise SystemExit(start.pads())
