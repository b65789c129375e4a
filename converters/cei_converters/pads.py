"""`cei-pads`: a picture of any end-effector with its pads' points and normals."""

from dataclasses import dataclass
from pathlib import Path

from cei_converters.cli import run
from cei_gym.errors import CEIError, unknown

EXAMPLE = """example:
  cei-pads --end_effector=Inspire --output=inspire.png
  cei-pads --end_effector=my_hand.yaml --pose=closed --output=my_hand.png"""
POSES = ("home", "half", "closed")


@dataclass
class PadsConfig:
    """Draw an end-effector with its functional representation: its pads' points and outward normals."""

    end_effector: str  # Catalogue name, or a YAML of your own.
    output: str  # PNG to write.
    pose: str = "half"  # home, half (half closed) or closed.
    points: int = 128  # Point-normal pairs in all.
    seed: int = 0  # Of the sampling.
    package_path: str | None = None  # Folders to look for ROS packages in, separated by colons.
    json: str | None = None  # File for the result as JSON.


def draw(config: PadsConfig) -> None:
    """Write the picture.

    Raises:
        CEIError: no such end-effector or pose, or the output exists.
    """
    from PIL import Image

    from cei_converters.cli.result import check_json_path, write_json
    from cei_gym.embodiment import EndEffectorSpec, build_embodiment, load_end_effector, load_spec, use_package_path
    from cei_gym.functional.picture import draw_representation
    from cei_gym.functional.representation import sample_representation

    if config.pose not in POSES:
        raise unknown("pose", config.pose, POSES)
    check_json_path(config.json)
    output = Path(config.output)
    if output.exists():
        raise CEIError(f"--output={output} already exists; choose another file or remove it first.")
    use_package_path(config.package_path)
    if config.end_effector.lower().endswith((".yaml", ".yml")):
        path = Path(config.end_effector)
        embodiment = build_embodiment(None, load_spec(EndEffectorSpec, path), path.parent)
    else:
        embodiment = build_embodiment(None, load_end_effector(config.end_effector))
    representation = sample_representation(embodiment, config.points, config.seed)
    share = POSES.index(config.pose) / 2
    picture = draw_representation(representation, (1 - share) * embodiment.home + share * embodiment.closed)
    output.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(output)
    names = [embodiment.body_names[body].split("/")[-1] for body in representation.body]
    pads = {name: names.count(name) for name in dict.fromkeys(names)}
    notes = list(embodiment.notes)
    write_json(config.json, {"end_effector": embodiment.name, "output": str(output), "pads": pads, "notes": notes})
    for note in notes:
        print(f"note: {note}")
    print(f"Wrote {output}: " + ", ".join(f"{count} points on {link}" for link, count in pads.items()) + ".")


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-pads`."""
    return run(PadsConfig, draw, args, prog="cei-pads", example=EXAMPLE)


if __name__ == "__main__":
    raise SystemExit(main())
