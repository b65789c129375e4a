"""`meta/cei.json`: what LeRobot's format has no home for (scene, environment, provenance). Its neighbours: `records`, and
`essentials`, what of it LeRobot's own tools carry along."""

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import draccus
import numpy as np
from draccus.utils import DraccusException

from cei_converters.dataset.step_time import StepTime
from cei_gym.arrays import Array
from cei_gym.demonstration import Scene
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import is_pose, load_json

FORMAT_VERSION = "2.0"
READABLE = ("1", "2")
"""Major versions that are read."""
METADATA_PATH = "meta/cei.json"
PICTURE_PATH = "meta/quality.png"
RECORDS_OF_1_0 = "episodes"
"""Where format 1.0 has what `records` has now."""
_MAY_BE_NULL = ("clouds", "total_episodes", "step_time_s")
MOST_LAG_S = 2.0
"""By more no camera's pictures trail the joints."""
REQUIRED = "embodiment, scene.T_world_base, scene.cameras (name, width, height, K, T_world_camera)"
START = "start_qpos"
"""Argument of environments: where the dataset's own demonstrations start."""
SENSORS = "sensors"
"""Argument of environments: what the robot feels, for demonstrations; the target's have none of it."""
BASE = "T_world_base"
"""Argument of environments: where the robot stands, if it is none that the simulator itself puts somewhere."""
_OPTIONAL = "scene.table_z_m"
CONVENTIONS = {
    "world": "right-handed, z up, metres",
    "camera": "OpenCV axes: x right, y down, z forward; T_world_camera maps camera to world",
    "joints": "observation.state: positions; action: absolute position targets; arm then end-effector",
    "point_cloud": "world frame, metres, cropped to scene.workspace_world; flat, its shape is in info.shape of its feature",
    "environment_state": "what the simulator knows of objects; under privileged.* no policy looks at it",
    "depth": "along the optical axis, 0 where unknown",
}


@dataclass(frozen=True)
class Environment:
    """The gymnasium environment that an episode replays in."""

    id: str | None = None
    kwargs: dict[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class Source:
    """The dataset that this one was converted from. What its card says of its license is carried over as it is."""

    repo_id: str
    embodiment: str
    root_name: str | None = None
    revision: str | None = None
    fingerprint: str | None = None
    license: Any = None  # an identifier, or a list of them
    license_name: str | None = None  # where the identifier is "other"
    license_link: str | None = None
    depth_cameras: tuple[str, ...] = ()  # those whose depth became clouds
    carried: tuple[str, ...] = ()  # features that were carried over as they are
    dropped: dict[str, str] = field(default_factory=dict[str, str])  # features that were not, and why


@dataclass(frozen=True)
class Provenance:
    """How a dataset came about; see `cei_converters.dataset.provenance.collect`."""

    source: Source | None = None
    options: dict[str, Any] = field(default_factory=dict[str, Any])
    inputs: dict[str, str] = field(default_factory=dict[str, str])  # what else it is made of, to its fingerprint
    pads: dict[str, Any] = field(default_factory=dict[str, Any])
    notes: dict[str, list[str]] = field(
        default_factory=dict[str, list[str]]
    )  # what was assumed or left out of robots' descriptions
    versions: dict[str, str] = field(default_factory=dict[str, str])
    git_commit: str | None = None
    date: str = ""
    command: str = ""


@dataclass(frozen=True)
class Metadata:
    """Contents of `meta/cei.json`.

    Attributes:
        embodiment: whose demonstrations they are.
        scene: base pose, cameras, workspace.
        environment: what they replay in.
        clouds: options of `cei-convert`'s clouds; None where they are the cameras' own.
        total_episodes: of the dataset that this was written for; None where it does not say.
        step_time_s: how long steps took, if that was timed; LeRobot's time stamps are frames at a fixed rate, whatever they took.
        provenance: how they came about.
        merged: how others came about that were put together with them; of which an episode is, its record says (`provenance`).
        conventions: frames and units, in words.
        format_version: of all this.
    """

    embodiment: str
    scene: Scene
    environment: Environment = field(default_factory=Environment)
    clouds: dict[str, Any] | None = None
    total_episodes: int | None = None
    step_time_s: StepTime | None = None
    provenance: Provenance = field(default_factory=Provenance)
    merged: tuple[Provenance, ...] = ()
    conventions: dict[str, str] = field(default_factory=lambda: dict(CONVENTIONS))
    format_version: str = FORMAT_VERSION

    @property
    def provenances(self) -> tuple[Provenance, ...]:
        """How they came about, in all."""
        return self.provenance, *self.merged

    @property
    def is_painted(self) -> bool:
        """Whether the target is painted over the source in its pictures, by the options of all that it was made by; an edited dataset does not say."""
        cameras = [provenance.options.get("cameras") for provenance in self.provenances]
        return all(isinstance(options, dict) and options.get("paint") is True for options in cameras)

    def provenance_of(self, record: Mapping[str, Any], where: str) -> Provenance:
        """How an episode came about, by its record.

        Raises:
            CEIError: the record names none.
        """
        which = record.get("provenance", 0)
        if which not in range(len(self.provenances)):
            raise CEIError(
                f"{where}: its provenance should be 0 to {len(self.provenances) - 1}, not {one_line(which, 60)}."
            )
        return self.provenances[which]

    def save(self, root: Path) -> None:
        """Write to a dataset's folder."""
        path = root / METADATA_PATH
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(plain(self), indent=1, allow_nan=False) + "\n")

    @classmethod
    def load(cls, root: Path) -> Self:
        """Read from a dataset's folder.

        Raises:
            CEIError: the file is missing, no JSON, of another version, or a field is missing or wrong.
        """
        path = root / METADATA_PATH
        where = f"{root.name}/{METADATA_PATH}"
        try:
            raw = load_json(path.read_text())
        except FileNotFoundError as error:
            raise CEIError(f"{where} is missing; it needs {REQUIRED}.") from error
        except (ValueError, OSError) as error:
            raise CEIError(f"{where} cannot be read: {error}; it should be a JSON object.") from error
        return cls.decode(raw, where)

    @classmethod
    def decode(cls, raw: object, where: str) -> Self:
        """From JSON types, which may be a stranger's.

        Raises:
            CEIError: they are of another version, or a field is missing or wrong.
        """
        if not isinstance(raw, dict):
            raise CEIError(f"{where} should be a JSON object with {REQUIRED}.")
        version = str(raw.get("format_version"))
        if version.split(".")[0] not in READABLE:
            raise CEIError(f"{where}: format_version is {version}, this program reads {FORMAT_VERSION}.")
        raw = {key: value for key, value in raw.items() if key != RECORDS_OF_1_0}
        try:
            metadata = draccus.decode(cls, raw)
        except DraccusException as error:
            raise CEIError(f"{where}: {one_line(error)}; needed: {REQUIRED}.") from error
        parts = [(f.name, getattr(metadata, f.name)) for f in dataclasses.fields(cls) if f.name not in _MAY_BE_NULL]
        parts += [
            *_values(metadata.scene, "scene"),
            ("environment.kwargs", getattr(metadata.environment, "kwargs", None)),
        ]
        empty = [name for name, value in parts if value is None and name != _OPTIONAL]
        if empty:  # draccus takes null for anything
            raise CEIError(f"{where}: {empty[0]} is null; needed: {REQUIRED}.")
        check_scene(metadata.scene, f"{where}: scene")
        if metadata.step_time_s is not None:
            metadata.step_time_s.check(where)
        if version.startswith("1.") and metadata.provenance.source is not None:  # where the options were
            return dataclasses.replace(metadata, clouds=metadata.provenance.options.get("clouds", {}))
        return metadata


def restore_with(root: Path) -> str:
    """A sentence: what gives an edited dataset back what it has lost."""
    return f"If it was edited: cei-restore --dataset.root={root} --original=<what it was made from>."


def _values(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Values of dataclasses in each other, and where they are."""
    if dataclasses.is_dataclass(value):
        for each in dataclasses.fields(value):
            yield from _values(getattr(value, each.name), f"{name}.{each.name}")
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            yield from _values(item, f"{name}.{i}")
    else:
        yield name, value


def plain(value: object) -> Any:
    """A value as JSON types: arrays to lists, dataclasses to dicts, not-a-number and infinity to null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int)) else str(value)


def check_scene(scene: Scene, where: str) -> None:
    """Check shapes, rigid transforms and intrinsics.

    Raises:
        CEIError: naming the field.
    """
    _check_pose(scene.T_world_base, f"{where}: T_world_base")
    workspace = scene.workspace_world
    if workspace.shape != (2, 3) or not np.isfinite(workspace).all() or not (workspace[0] < workspace[1]).all():
        raise CEIError(f"{where}: workspace_world should be [[x, y, z] lower, [x, y, z] upper] in metres.")
    if scene.table_z_m is not None and not math.isfinite(scene.table_z_m):
        raise CEIError(f"{where}: table_z_m should be a finite number of metres, or null.")
    names = [camera.name for camera in scene.cameras]
    if len(set(names)) != len(names):
        raise CEIError(f"{where}: two cameras share a name among {', '.join(names)}.")
    for camera in scene.cameras:
        place = f"{where}: camera {camera.name!r}"
        _check_pose(camera.T_world_camera, f"{place}: T_world_camera")
        K = camera.K
        if K.shape != (3, 3) or not np.isfinite(K).all() or min(np.diag(K)) <= 0 or not np.allclose(K[2], (0, 0, 1)):
            raise CEIError(
                f"{place}: K should be 3x3 [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, fx and fy positive."
            )
        if not abs(camera.lag_s) <= MOST_LAG_S:
            raise CEIError(f"{place}: lag_s should be at most {MOST_LAG_S:g} s, not {camera.lag_s:g}.")
        if camera.width <= 0 or camera.height <= 0:
            raise CEIError(f"{place}: size {camera.width}x{camera.height} should be positive.")


def _check_pose(T: Array, where: str) -> None:
    if not is_pose(T):
        raise CEIError(f"{where} should be a 4x4 rigid transform [[R, t], [0, 0, 0, 1]].")


def _decode_array(raw: object, _path: object) -> Array:
    return np.asarray(raw, dtype=np.float64)


draccus.decode.register(np.ndarray, _decode_array)
