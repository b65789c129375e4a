"""`cei-calibrate`: where a dataset's camera is, and its focal length, from its joints and pictures alone."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cei_converters.cli import DatasetConfig, run
from cei_converters.cli.options import check_range, parse_pose
from cei_gym import extras
from cei_gym.errors import CEIError, unknown

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cei_converters.sources.calibration import Calibration
    from cei_converters.sources.filmed import Clicked, Filmed
    from cei_converters.sources.source import Source
    from cei_gym.arrays import Array
    from cei_gym.demonstration import Camera
    from cei_gym.embodiment import Embodiment
    from cei_gym.painting.camera_fit import CameraFit

EXAMPLE = """example:
  cei-calibrate --dataset.repo_id=me/real_panda --source=Panda-PandaGripper --camera=front \\
      --calibration=rough.yaml --output=cameras.yaml --sheet=front.png"""

SURFACES, OUTLINES = "surfaces", "outlines"
_SHOWN = 6
_GUESS_RGB, _FOUND_RGB = (230, 60, 40), (40, 220, 90)


@dataclass
class CalibrateConfig:
    """Find a camera that stands still from a dataset's joints and pictures: no board, no depth. It starts from a rough guess."""

    dataset: DatasetConfig
    camera: str  # The camera's feature, or the last part of its key.
    output: Path  # YAML to write, as --calibration of cei-convert reads it.
    calibration: Path | None = None  # YAML with the guess; default: meta/cei.json. What else it says is kept.
    # YAML: four or more points of the robot, and where pictures show them; of the guess only the focal length is used.
    clicks: Path | None = None
    # surfaces, or outlines: of real pictures, whose covers and sheen no description has; finds the video's lag, too.
    by: str = SURFACES
    # By outlines: joint maps of other robots in view on the same base, such as another arm, each with its embodiment.
    beside: list[Path] | None = None
    sheet: Path | None = None  # PNG: outlines of the robot in some pictures, by the guess and as found.
    source: str | None = None  # Embodiment of a dataset that does not say it (no meta/cei.json).
    source_pose: str | None = None  # Base pose of such a dataset: x,y,z in m, then maybe qw,qx,qy,qz.
    joint_map: Path | None = None  # YAML that tells which columns of a dataset are which joints.
    package_path: list[Path] | None = None  # Folders to look for robots' ROS packages in, separated by colons.
    pictures: int = 18  # That are looked at, spread over the dataset.
    json: Path | None = None  # File for the result as JSON.
    overwrite: bool = False  # Replace files that are there already.

    def __post_init__(self) -> None:
        check_range("--pictures", self.pictures, 8, 200)
        if self.by not in (SURFACES, OUTLINES):
            raise unknown("way to find a camera (--by)", self.by, [SURFACES, OUTLINES])
        if self.beside and self.by != OUTLINES:
            raise CEIError(f"--beside is for --by={OUTLINES}; give both, or leave it out.")
        parse_pose("--source_pose", self.source_pose)


def calibrate(config: CalibrateConfig) -> None:
    """Find the camera; write its calibration.

    Raises:
        CEIError: bad options or data, no guess, or nothing that pictures bear out.
    """
    extras.require_module("cei-calibrate", "cv2")
    from cei_converters.cli.outputs import JOINT_MAP, JSON, PICTURE, Outputs
    from cei_converters.cli.progress import progress_bar
    from cei_converters.cli.result import write_json
    from cei_converters.conversion.cameras import calibrated
    from cei_converters.sources.calibration import load_calibration
    from cei_converters.sources.filmed import Filmed
    from cei_converters.sources.formats import open_source
    from cei_gym.embodiment import use_package_path

    outputs = Outputs(config.overwrite)
    output, json = outputs.file("--output", config.output, JOINT_MAP), outputs.file("--json", config.json, JSON)
    sheet = outputs.file("--sheet", config.sheet, PICTURE)
    assert output is not None
    use_package_path(config.package_path)
    given = None if config.calibration is None else load_calibration(config.calibration)
    reader = open_source(
        config.dataset.repo_id,
        config.dataset.root,
        embodiment=config.source,
        T_world_base=parse_pose("--source_pose", config.source_pose),
        calibration=given,
        joint_map=config.joint_map,
        joints_only=True,
    )
    key = _feature(reader, config.camera)
    (guess,) = calibrated({key: reader.cameras[key]}, reader.scene.cameras, "cei-calibrate").values()
    beside = [
        open_source(config.dataset.repo_id, config.dataset.root, joint_map=path, joints_only=True)
        for path in config.beside or ()
    ]
    filmed = Filmed([reader, *beside], key, config.pictures)
    clicked = None if config.clicks is None else filmed.clicks(config.clicks, guess)
    guess = guess if clicked is None else clicked(guess.lag_s).camera(guess)
    robots = [source.embodiment for source in (reader, *beside)]
    with progress_bar("%") as progress:
        task = progress.add_task("finding the camera", total=100)
        found = _found(
            config.by,
            robots,
            reader.scene.T_world_base,
            guess,
            filmed,
            clicked,
            lambda share: progress.update(task, completed=round(100 * share)),
        )
    with output.whole() as partial:
        partial.write_text(_yaml(reader, given, found))
    if sheet is not None:
        from PIL import Image

        picture = _outlined(robots, reader.scene.T_world_base, guess, found.camera, filmed)
        with sheet.whole() as partial:
            Image.fromarray(picture).save(partial, format="PNG")
    result = {
        "camera": found.camera.name,
        "pictures": len(filmed.pictures),
        "apart_px": found.apart_px,
        "apart_most_px": found.apart_most_px,
        "moved_px": found.moved_px,
        "explained": found.agreement.explained,
        "K": found.camera.K.tolist(),
        "T_world_camera": found.camera.T_world_camera.tolist(),
        "lag_s": found.camera.lag_s,
        "output": str(output),
    }
    write_json(json, result)
    print(_sentence(found))
    print(f"Wrote {output}.")


def _feature(reader: "Source", camera: str) -> str:
    """The key of a camera's feature.

    Raises:
        CEIError: there is no such camera.
    """
    from cei_converters.dataset.depth import camera_name

    coloured = [key for key, feature in reader.cameras.items() if feature["shape"][-1] == 3]
    for key in coloured:
        if camera in (key, camera_name(key)):
            return key
    raise unknown("camera with pictures", camera, [camera_name(key) for key in coloured])


def _sentence(found: "CameraFit") -> str:
    position = ", ".join(f"{value:.3f}" for value in found.camera.T_world_camera[:3, 3])
    camera = found.camera
    lag = f" Its pictures trail the joints by {camera.lag_s:.3f} s." if camera.lag_s else ""
    return (
        f"Camera {found.camera.name!r} is at ({position}) m, with a focal length of {found.camera.K[0, 0]:.1f} pixels; on the robot {found.moved_px:.1f} pixels from "
        f"the guess. Two halves of the pictures agree within {found.apart_px:.2f} pixels (at most {found.apart_most_px:.2f}); of what moves {100 * found.agreement.explained:.0f} % "
        f"is where joints say.{lag}"
    )


def _yaml(reader: "Source", given: "Calibration | None", found: "CameraFit") -> str:
    """The calibration with the camera in the place of the guess."""
    import yaml

    cameras = {camera.name: camera for camera in reader.scene.cameras} | {found.camera.name: found.camera}
    fields = {
        name: {
            "width": camera.width,
            "height": camera.height,
            "K": camera.K.tolist(),
            "T_world_camera": camera.T_world_camera.tolist(),
            **({"lag_s": round(camera.lag_s, 4)} if camera.lag_s else {}),
        }
        for name, camera in cameras.items()
    }
    text: dict[str, object] = {"cameras": fields, "T_world_base": reader.scene.T_world_base.tolist()}
    if given is not None and given.workspace_world is not None:
        text["workspace_world"] = given.workspace_world.tolist()
    said = f"# {_sentence(found)}\n# Found by cei-calibrate. Focal length and distance are known together better than each: good for painting, not for measuring.\n"
    return said + yaml.safe_dump(text, sort_keys=False, default_flow_style=None)


def _found(
    by: str,
    robots: "Sequence[Embodiment]",
    T_world_base: "Array",
    guess: "Camera",
    filmed: "Filmed",
    clicked: "Clicked | None",
    advance: "Callable[[float], None]",
) -> "CameraFit":
    """The camera by surfaces or by outlines."""
    from cei_gym.painting import Footage, fit_camera, fit_outlines

    if by == OUTLINES:
        footage = Footage(filmed.pictures.astype(np.float32) / 255, filmed.qpos_at, clicked)
        return fit_outlines(robots, T_world_base, guess, footage, advance)[0]
    clicks = None if clicked is None else clicked(guess.lag_s)
    return fit_camera(robots[0], T_world_base, guess, filmed.pictures, filmed.qpos_at(guess.lag_s), advance, clicks)


def _outlined(
    robots: "Sequence[Embodiment]", T_world_base: "Array", guess: "Camera", found: "Camera", filmed: "Filmed"
) -> "Array":
    """(H', W', 3) uint8: the robots' outlines in some pictures, by the guess (red) and as found (green)."""
    import cv2

    from cei_converters.sources.recording import spread
    from cei_gym.painting.view import RobotView

    shown: list[Array] = []
    for i in spread(len(filmed.pictures), _SHOWN):
        picture = np.ascontiguousarray(filmed.pictures[i])
        for camera, colour in ((guess, _GUESS_RGB), (found, _FOUND_RGB)):
            view = RobotView(robots[0], T_world_base, camera, robots[1:])
            mask = view.silhouette(filmed.qpos_at(camera.lag_s)[i]).astype(np.uint8)
            outlines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
            picture = cv2.drawContours(picture, outlines, -1, colour, 1)
        shown.append(picture)
    shown += [np.zeros_like(shown[0])] * (-len(shown) % 3)
    return np.concatenate([np.concatenate(shown[row : row + 3], axis=1) for row in range(0, len(shown), 3)])


def main(args: list[str] | None = None) -> int:
    """Entry point of `cei-calibrate`."""
    return run(CalibrateConfig, calibrate, args, prog="cei-calibrate", example=EXAMPLE)


if __name__ == "__main__":
    from cei_converters import start

    raise SystemExit(start.calibrate())
