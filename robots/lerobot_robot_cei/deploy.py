"""`cei-deploy`: what a robot must offer for a checkpoint to act on it, and a copy of the checkpoint that knows the lab's own cameras, or paints their pictures."""

import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cei_converters.cli import run
from cei_converters.cli.options import check_overwrite
from cei_converters.cli.outputs import JSON, Outputs
from cei_converters.cli.result import write_json
from cei_converters.dataset.essentials import Remains
from cei_converters.dataset.locate import INFO_PATH
from cei_converters.dataset.opening import find_metadata
from cei_converters.dataset.place import absent, check_parent
from cei_converters.sources.calibration import FORMAT, Calibration, load_calibration
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_json
from lerobot_robot_cei.pictures import RobotPictures
from lerobot_robot_cei.trained_on import PICTURES_STEP, STEP, STEPS_PATH, TrainedOn, find

CONFIG_PATH = "config.json"
"""Where a checkpoint says what its policy looks at."""
_PICTURE = "observation.images."
_FIRST = ("rename_observations_processor", "to_batch_processor")  # steps that the one that paints comes after

EXAMPLE = f"""example:
  cei-deploy --policy=outputs/train/checkpoints/last/pretrained_model
  cei-deploy --policy=outputs/train/checkpoints/last/pretrained_model --calibration=cameras.yaml --new_policy=outputs/on_our_robot
  cei-deploy --policy=outputs/act/checkpoints/last/pretrained_model --trained_on=data/painted --paint --new_policy=outputs/act_on_our_robot

{FORMAT}"""


@dataclass
class DeployConfig:
    """Say what a robot must offer for a policy to act on it; copy its checkpoint with one's own cameras (--calibration), or pictures painted (--paint)."""

    policy: Path  # Its checkpoint, .../pretrained_model.
    calibration: Path | None = None  # Where the robot's own cameras, base and workspace are; see below.
    paint: bool = False  # In the policy's pictures, paint the robot over itself as in the data that it was trained on, which is painted.
    trained_on: str | None = (
        None  # Folder of that data, for a checkpoint that does not say, such as one of LeRobot's ACT.
    )
    new_policy: Path | None = None  # Folder for the copy that knows them.
    json: Path | None = None  # File for what a robot must offer, as JSON.
    overwrite: bool = False  # Replace a JSON file that is there already; never a checkpoint.

    def __post_init__(self) -> None:
        check_overwrite(self.overwrite, self.json)
        if (self.calibration is None and not self.paint) != (self.new_policy is None):
            raise CEIError(
                "--calibration or --paint, and --new_policy, go together: the copy is what knows the calibration, and paints."
            )


def deploy(config: DeployConfig) -> TrainedOn:
    """Print what a robot must offer, and make the copy.

    Raises:
        CEIError: the checkpoint says nothing of a robot, the calibration does not fit it, or the new folder is there already.
    """
    result = Outputs(config.overwrite).file("--json", config.json, JSON)
    data = config.policy if config.trained_on is None else find(config.trained_on)
    known = TrainedOn.load(data)
    if config.paint:
        _check_painted(data)
    said: list[str] = []
    if config.calibration is not None:
        calibration = load_calibration(config.calibration)
        names = [camera.name for camera in known.metadata.scene.cameras]
        if extra := [camera.name for camera in calibration.cameras if camera.name not in names]:
            raise CEIError(
                f"{config.calibration.name} has camera {', '.join(extra)}; the policy's data are of {', '.join(names)}, one for each."
            )
        known = known.seen_by(calibration)
        said.append(f"{', '.join(what_is_said(calibration))} of {config.calibration.name}")
    if config.new_policy is not None:
        painted = painted_cameras(config.policy, known) if config.paint else None
        if painted is not None:
            said.append(f"pictures of {', '.join(painted)} that are painted with {known.metadata.embodiment}")
        _copy(config.policy, absent(config.new_policy), known, painted)
        print(f"Copied to {config.new_policy}, with {' and '.join(said)}.")
    for line in needs(known):
        print(line)
    write_json(result, known.encode())
    return known


def needs(known: TrainedOn) -> list[str]:
    """What a robot must offer, a line each."""
    embodiment, scene = known.embodiment(), known.metadata.scene
    lower, upper = embodiment.lower, embodiment.upper
    lines = [f"{embodiment.name}, {known.fps:g} actions a second (lerobot-rollout --fps={known.fps:g})."]
    if (step_time := known.metadata.step_time_s) is not None:
        lines.append(known.waiting() or step_time.sentence(known.fps))
    lines.append("Joints, by name in any order (--robot.type=cei); those in brackets follow and need not be there:")
    for q, name in enumerate(embodiment.joint_names):
        unit = embodiment.joint_units[q]
        shown = f"{name}.pos" if q in embodiment.coupled.independent else f"({name}.pos)"
        starts = " or ".join(f"{start[q]:.3f}" for start in known.starts)
        lines.append(f"  {shown}  {lower[q]:.3f} to {upper[q]:.3f} {unit}, starts at {starts}")
    if known.cloud_shape is None:
        return [*lines, "No clouds: it was trained on something else."]
    for camera in scene.cameras:
        place = np.round(camera.T_world_camera[:3, 3], 3).tolist()
        lines.append(
            f"Depth {camera.name}_depth, {camera.width}x{camera.height}, whole mm; the camera stands at {place} m, the robot's base at "
            f"{np.round(scene.T_world_base[:3, 3], 3).tolist()} m."
        )
    low, high = scene.workspace_world.round(3).tolist()
    return [*lines, f"Looked at: the box from {low} to {high} m, whose floor lies just above the table."]


def painted_cameras(policy: Path, known: TrainedOn) -> list[str]:
    """The cameras whose pictures a checkpoint's policy looks at.

    Raises:
        CEIError: it looks at none, or one of them is not calibrated, or of another size.
    """
    try:
        inputs = load_json((policy / CONFIG_PATH).read_text())["input_features"]
        shapes = {key.removeprefix(_PICTURE): tuple(inputs[key]["shape"]) for key in inputs if key.startswith(_PICTURE)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise CEIError(f"{policy / CONFIG_PATH} cannot be read: {one_line(error)}.") from error
    if not shapes:
        raise CEIError(f"--paint: the policy looks at no pictures; its inputs are {', '.join(inputs)}.")
    cameras = {camera.name: camera for camera in known.metadata.scene.cameras}
    for name, shape in shapes.items():
        if name not in cameras:
            raise CEIError(
                f"--paint: {_PICTURE}{name} is of no calibrated camera ({', '.join(cameras) or 'there is none'}); one that moves, or is not calibrated, "
                "cannot be painted: train without it."
            )
        size = 3, cameras[name].height, cameras[name].width
        if shape != size:
            raise CEIError(f"--paint: the policy's {_PICTURE}{name} are {shape}, its camera's {size}.")
    return [*shapes]


def what_is_said(calibration: Calibration) -> list[str]:
    """What a calibration says something of."""
    said = [f"camera {camera.name}" for camera in calibration.cameras]
    return said + [name for name in ("workspace_world", "T_world_base") if getattr(calibration, name) is not None]


def _check_painted(data: Path) -> None:
    """Check that pictures are painted, where data say so; a checkpoint and a dataset that was edited do not."""
    metadata = find_metadata(data) if (data / INFO_PATH).is_file() else None
    if metadata is None or isinstance(metadata, Remains):
        print("Whether the pictures that the policy was trained on are painted is not said; it is taken to be so.")
    elif not metadata.is_painted:
        raise CEIError(
            f"--paint: pictures of {data} are not painted (cei-convert --cameras.paint), so that the policy has learnt from others; leave it out."
        )


def _copy(policy: Path, new_policy: Path, known: TrainedOn, painted: list[str] | None) -> None:
    """A checkpoint's files, its steps with what is known now, and with one that paints these cameras' pictures."""
    if not (policy / STEPS_PATH).is_file():
        raise CEIError(f"{policy} is no checkpoint (with {STEPS_PATH}); nothing to copy.")
    check_parent(new_policy)
    new_policy.parent.mkdir(parents=True, exist_ok=True)
    steps = load_json((policy / STEPS_PATH).read_text())
    for step in steps["steps"]:
        if step.get("registry_name") in (STEP, PICTURES_STEP):
            step["config"]["trained_on"] = known.encode()
    if painted is not None:
        steps["steps"] = [step for step in steps["steps"] if step.get("registry_name") != PICTURES_STEP]
        config = RobotPictures(known.encode(), painted).get_config()
        place = 1 + max((i for i, step in enumerate(steps["steps"]) if step.get("registry_name") in _FIRST), default=-1)
        steps["steps"].insert(place, {"registry_name": PICTURES_STEP, "config": config})
    with tempfile.TemporaryDirectory(
        dir=new_policy.parent, prefix=f".{new_policy.name}-"
    ) as folder:  # whole, or not at all
        made = Path(folder) / "made"
        made.mkdir()
        for path in sorted(policy.iterdir()):
            if path.is_file():
                shutil.copyfile(path, made / path.name)
        (made / STEPS_PATH).write_text(json.dumps(steps, indent=2) + "\n")
        made.rename(new_policy)


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-deploy`."""
    return run(DeployConfig, deploy, args, prog="cei-deploy", example=EXAMPLE)


if __name__ == "__main__":
    raise SystemExit(main())
