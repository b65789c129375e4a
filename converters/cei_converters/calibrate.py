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
    from cei_converters.sources.calibration import Calibration
    from cei_converters.sources.source import Source
    from cei_gym.arrays import Array
    from cei_gym.demonstration import Camera
    from cei_gym.painting.camera_fit import CameraFit
    from cei_gym.painting.clicks import Clicks

EXAMPLE = """example:
  cei-calibrate --dataset.repo_id=me/real_panda --source=Panda-PandaGripper --camera=front \\
      --calibration=rough.yaml --output=cameras.yaml --sheet=front.png"""

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
    from cei_converters.sources.formats import open_source
    from cei_gym.embodiment import use_package_path
    from cei_gym.painting.camera_fit import fit_camera

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
    clicks = None if config.clicks is None else _clicks(reader, config.clicks, guess)
    guess = guess if clicks is None else clicks.camera(guess)
    pictures, qpos = _sampled(reader, key, config.pictures)
    base = reader.scene.T_world_base
    with progress_bar("%") as progress:
        task = progress.add_task("finding the camera", total=100)
        found = fit_camera(
            reader.embodiment,
            base,
            guess,
            pictures,
            qpos,
            lambda share: progress.update(task, completed=round(100 * share)),
            clicks,
        )
    with output.whole() as partial:
        partial.write_text(_yaml(reader, given, found))
    if sheet is not None:
        from PIL import Image

        picture = _outlined(reader, guess, found, pictures, qpos)
        with sheet.whole() as partial:
            Image.fromarray(picture).save(partial, format="PNG")
    result = {
        "camera": found.camera.name,
        "pictures": len(pictures),
        "apart_px": found.apart_px,
        "apart_most_px": found.apart_most_px,
        "moved_px": found.moved_px,
        "explained": found.agreement.explained,
        "K": found.camera.K.tolist(),
        "T_world_camera": found.camera.T_world_camera.tolist(),
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


def _clicks(reader: "Source", path: Path, guess: "Camera") -> "Clicks":
    """What was clicked, in the world.

    Raises:
        CEIError: the file is wrong, or an episode or frame is none of the dataset's.
    """
    from cei_converters.sources.clicks import load_clicks
    from cei_gym.kinematics import KinematicTree
    from cei_gym.painting.clicks import Clicks

    clicks = load_clicks(path, reader.embodiment, guess.width, guess.height)
    tree = KinematicTree(reader.embodiment)
    joints: dict[int, Array] = {}
    points: list[Array] = []
    for i, click in enumerate(clicks):
        if click.episode >= len(reader):
            raise CEIError(f"{path.name}: click {i + 1}: episode {click.episode} is none of the {len(reader)}.")
        if click.episode not in joints:
            joints[click.episode] = reader.read(click.episode, clouds=False).qpos
        qpos = joints[click.episode]
        if click.frame >= len(qpos):
            raise CEIError(
                f"{path.name}: click {i + 1}: frame {click.frame} is none of the {len(qpos)} of episode {click.episode}."
            )
        T_world_link = reader.scene.T_world_base @ tree.forward(qpos[click.frame])[click.body]
        points.append(T_world_link[:3, :3] @ click.xyz_link + T_world_link[:3, 3])
    return Clicks(np.stack(points), np.stack([click.pixel for click in clicks]))


def _sampled(reader: "Source", key: str, most: int) -> tuple["Array", "Array"]:
    """(N, H, W, 3) uint8 pictures, spread over episodes and their frames, and (N, n) joints in them."""
    from cei_converters.sources.recording import spread

    episodes = spread(len(reader), max(1, most // 6))
    each = -(-most // len(episodes))
    pictures: list[Array] = []
    qpos: list[Array] = []
    for index in episodes:
        joints = reader.read(index, clouds=False).qpos
        few = np.array(spread(len(joints), each))
        pictures.append(reader.pictures(index).at(few).decode(key))
        qpos.append(joints[few])
    if sum(map(len, pictures)) < 8:
        raise CEIError(f"{reader.repo_id} has {sum(map(len, pictures))} frames; a camera is found by 8 or more.")
    return np.concatenate(pictures)[:most], np.concatenate(qpos)[:most]


def _sentence(found: "CameraFit") -> str:
    position = ", ".join(f"{value:.3f}" for value in found.camera.T_world_camera[:3, 3])
    return (
        f"Camera {found.camera.name!r} is at ({position}) m, with a focal length of {found.camera.K[0, 0]:.1f} pixels; on the robot {found.moved_px:.1f} pixels from "
        f"the guess. Two halves of the pictures agree within {found.apart_px:.2f} pixels (at most {found.apart_most_px:.2f}); of what moves {100 * found.agreement.explained:.0f} % "
        "is where joints say."
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
        }
        for name, camera in cameras.items()
    }
    text: dict[str, object] = {"cameras": fields, "T_world_base": reader.scene.T_world_base.tolist()}
    if given is not None and given.workspace_world is not None:
        text["workspace_world"] = given.workspace_world.tolist()
    said = f"# {_sentence(found)}\n# Found by cei-calibrate. Focal length and distance are known together better than each: good for painting, not for measuring.\n"
    return said + yaml.safe_dump(text, sort_keys=False, default_flow_style=None)


def _outlined(reader: "Source", guess: "Camera", found: "CameraFit", pictures: "Array", qpos: "Array") -> "Array":
    """(H', W', 3) uint8: the robot's outline in some pictures, by the guess (red) and as found (green)."""
    import cv2

    from cei_converters.sources.recording import spread
    from cei_gym.painting.view import RobotView

    views = [
        (RobotView(reader.embodiment, reader.scene.T_world_base, camera), colour)
        for camera, colour in ((guess, _GUESS_RGB), (found.camera, _FOUND_RGB))
    ]
    shown: list[Array] = []
    for i in spread(len(pictures), _SHOWN):
        picture = np.ascontiguousarray(pictures[i])
        for view, colour in views:
            mask = view.silhouette(qpos[i]).astype(np.uint8)
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
