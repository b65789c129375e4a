"""Calibration of a dataset: where its cameras, its table and its robot's base are, from a YAML file."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset.metadata import check_scene
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera, Scene
from cei_gym.errors import CEIError, one_line, unknown
from cei_gym.untrusted import load_yaml

FORMAT = """a calibration (world z up, metres; T_world_camera maps camera to world, axes x right, y down, z forward); any part may be left out:
  cameras:
    front:  # the last part of the key of depth, or of pictures to paint (--cameras.paint)
      width: 640
      height: 480
      K: {fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0}  # px; or 3x3
      T_world_camera: {position: [1.0, 0.0, 1.5], quaternion_wxyz: [0.0, 0.7071, 0.7071, 0.0]}  # or 4x4
      lag_s: 0.1  # by so much its pictures trail the joints; default: 0
  workspace_world: [[0.2, -0.5, 0.0], [0.9, 0.5, 1.0]]  # the box clouds are cropped to; its floor is the table, but for --table_z_m
  T_world_base: {position: [0.0, 0.0, 0.0], quaternion_wxyz: [1.0, 0.0, 0.0, 0.0]}  # or --source_pose; default: the world's origin"""
_CAMERA_FIELDS = ("width", "height", "K", "T_world_camera")
_FIELDS = ("cameras", "workspace_world", "T_world_base")


@dataclass(frozen=True)
class Calibration:
    """What a file says of a scene; None where it says nothing.

    Attributes:
        cameras: that stand still.
        workspace_world: (2, 3) lower and upper corner, metres.
        T_world_base: (4, 4) pose of the robot's base.
    """

    cameras: tuple[Camera, ...] = ()
    workspace_world: Array | None = None
    T_world_base: Array | None = None

    def over(self, scene: Scene) -> Scene:
        """A scene with what the file says in place of its own; cameras that the file does not name stay."""
        given = {name: value for name in _FIELDS[1:] if (value := getattr(self, name)) is not None}
        if self.workspace_world is not None:  # whose floor is the table
            given["table_z_m"] = None
        cameras = {camera.name: camera for camera in (*scene.cameras, *self.cameras)}
        return replace(scene, cameras=tuple(cameras.values()), **given)


def load_calibration(path: str | Path) -> Calibration:
    """Read and check a calibration file; see `FORMAT`.

    Raises:
        CEIError: naming the file and the field.
    """
    path = Path(path)
    try:
        raw = load_yaml(path.read_text())
    except (OSError, ValueError) as error:
        raise CEIError(f"calibration {path} cannot be read: {one_line(error)}.") from error
    where = path.name
    fields = _mapping(raw, where, _FIELDS, required=())
    cameras = {} if fields.get("cameras") is None else fields["cameras"]
    if cameras == {} and all(fields.get(name) is None for name in _FIELDS[1:]):
        raise CEIError(f"{where} says nothing; it should have at least one of {', '.join(_FIELDS)}.")
    if not isinstance(cameras, dict):
        raise CEIError(f"{where}: cameras should map each camera's name to {', '.join(_CAMERA_FIELDS)}.")
    for name in cameras:
        if not isinstance(name, str):
            raise CEIError(f"{where}: cameras: {one_line(name, 60)} should be a name; write it in quotes.")
    workspace, base = fields.get("workspace_world"), fields.get("T_world_base")
    calibration = Calibration(
        tuple(_camera(name, fields, f"{where}: camera {name!r}") for name, fields in cameras.items()),
        None if workspace is None else _array(workspace, f"{where}: workspace_world"),
        None if base is None else _pose(base, f"{where}: T_world_base"),
    )
    check_scene(calibration.over(Scene(np.eye(4), (), np.array([[0.0] * 3, [1.0] * 3]))), where)
    return calibration


def _camera(name: str, raw: object, where: str) -> Camera:
    fields = _mapping(raw, where, (*_CAMERA_FIELDS, "lag_s"), _CAMERA_FIELDS)
    for side in ("width", "height"):
        if type(fields[side]) is not int:
            raise CEIError(f"{where}: {side} should be a whole number of pixels, not {fields[side]!r}.")
    K, T = _intrinsics(fields["K"], f"{where}: K"), _pose(fields["T_world_camera"], f"{where}: T_world_camera")
    lag_s = float(_array(fields.get("lag_s", 0.0), f"{where}: lag_s", shape=()))
    return Camera(name, fields["width"], fields["height"], K, T, lag_s)


def _intrinsics(raw: object, where: str) -> Array:
    """(3, 3), from rows or from fx, fy, cx, cy."""
    if not isinstance(raw, dict):
        return _array(raw, where)
    fields = _mapping(raw, where, ("fx", "fy", "cx", "cy"))
    fx, fy, cx, cy = (_array(fields[name], f"{where}.{name}", shape=()) for name in ("fx", "fy", "cx", "cy"))
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])


def _pose(raw: object, where: str) -> Array:
    """(4, 4), from rows or from a position and a quaternion."""
    if not isinstance(raw, dict):
        return _array(raw, where)
    from scipy.spatial.transform import Rotation

    fields = _mapping(raw, where, ("position", "quaternion_wxyz"))
    T = np.eye(4)
    T[:3, 3] = _array(fields["position"], f"{where}.position", shape=(3,))
    quaternion_wxyz = _array(fields["quaternion_wxyz"], f"{where}.quaternion_wxyz", shape=(4,))
    if not np.isclose(np.linalg.norm(quaternion_wxyz), 1, atol=1e-2):
        raise CEIError(f"{where}.quaternion_wxyz should have length 1, not {np.linalg.norm(quaternion_wxyz):.4g}.")
    T[:3, :3] = Rotation.from_quat(quaternion_wxyz, scalar_first=True).as_matrix()
    return T


def _mapping(raw: object, where: str, valid: Iterable[str], required: Iterable[str] | None = None) -> dict[str, Any]:
    """A mapping with these fields, all of them required unless said otherwise."""
    valid = tuple(valid)
    if not isinstance(raw, dict):
        raise CEIError(f"{where} should be a mapping with {', '.join(valid)}.")
    for name in raw:
        if name not in valid:
            raise CEIError(f"{where}: {unknown('field', name, valid)}")
    missing = [name for name in (valid if required is None else required) if name not in raw]
    if missing:
        raise CEIError(f"{where}: {', '.join(missing)} missing; it should have {', '.join(valid)}.")
    return raw


def _array(raw: object, where: str, shape: tuple[int, ...] | None = None) -> Array:
    """Finite numbers, of a shape if one is given."""
    try:
        array = np.array(np.nan) if _has_other(raw) else np.asarray(raw, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if not np.isfinite(array).all() or shape not in (None, array.shape):
        wanted = "numbers in rows of equal length" if shape is None else f"{shape[0]} numbers" if shape else "a number"
        raise CEIError(f"{where} should be {wanted}, not {one_line(raw, 60)}.")
    return array


def _has_other(raw: object) -> bool:
    """Whether anything in lists is no number: NumPy takes yes, no and text in digits for numbers."""
    return any(map(_has_other, raw)) if isinstance(raw, list) else type(raw) not in (int, float)
