"""Depth features of a LeRobot dataset, images or video, as metres."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset.decoding import decode_frames, encoded_images
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError, one_line, unknown

MM_PER_M = 1000.0
_UNITS = ("mm", "m")


def camera_name(key: str) -> str:
    """Name of a feature's camera: the last part of its key."""
    return key.rpartition(".")[2]


def check_depth_feature(key: str, feature: Mapping[str, Any], cameras: Mapping[str, Camera]) -> None:
    """Check that a depth feature can become points.

    Raises:
        CEIError: its camera is not calibrated, or for another size, or it is no image or video of one channel in mm or m.
    """
    name, shape = camera_name(key), tuple(feature["shape"])
    if name not in cameras:
        raise CEIError(
            f"{key} has no calibration: {', '.join(cameras) or 'no camera'} is calibrated; give width, height, K and "
            f"T_world_camera of {name!r} with --calibration=FILE.yaml (cei-convert --help shows one)."
        )
    if feature["dtype"] not in ("image", "video"):
        raise CEIError(f"{key} is marked as depth but stored as {feature['dtype']}; it should be image or video.")
    camera = cameras[name]
    if shape not in ((camera.height, camera.width, 1), (1, camera.height, camera.width)):
        size = f"{camera.width}x{camera.height}"
        raise CEIError(
            f"{key} has shape {shape} but camera {name!r} is calibrated for {size}: "
            f"it should be ({camera.height}, {camera.width}, 1)."
        )
    unit = (feature.get("info") or {}).get("depth_unit")
    if unit is not None and unit not in _UNITS:
        raise unknown(f"depth_unit of {key}", unit, _UNITS)


def image_depth_m(column: Any, feature: Mapping[str, Any], camera: Camera, where: str) -> Array:
    """A column of depth images as (T, H, W) float32 metres, 0 where unknown.

    Raises:
        CEIError: a cell is no depth image of the camera's size.
    """
    import cv2  # three times as fast as Pillow, and without the GIL

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what is wrong is said below

    unit = (feature.get("info") or {}).get("depth_unit")
    depth_m = np.empty((len(column), camera.height, camera.width), np.float32)
    for frame, stored in enumerate(encoded_images(column, where)):
        depth = cv2.imdecode(np.frombuffer(stored, np.uint8), cv2.IMREAD_UNCHANGED) if stored else None
        if depth is None or depth.shape != depth_m.shape[1:]:
            found = "none" if depth is None else f"one of {'x'.join(map(str, depth.shape[::-1]))}"
            size = f"{camera.width}x{camera.height}"
            raise CEIError(f"{where}: frame {frame} is no {size} depth image, but {found}.")
        depth_m[frame] = depth
        unit = unit or ("m" if depth.dtype.kind == "f" else "mm")  # as LeRobot takes it
    if unit == "mm":
        depth_m /= MM_PER_M
    depth_m[~np.isfinite(depth_m)] = 0
    return depth_m


def video_depth_m(path: Path, times_s: Array, fps: float, feature: Mapping[str, Any]) -> Array:
    """Frames of a depth video at (T,) times as (T, H, W) float32 metres, 0 where unknown.

    LeRobot's depth video has no "unknown": what was 0 or out of range reads as an end of the range, so both ends are.

    Raises:
        CEIError: the video cannot be decoded at these times.
    """
    from lerobot.configs.video import DEPTH_QMAX, DepthEncoderConfig
    from lerobot.datasets.depth_utils import dequantize_depth

    codes = decode_frames(path, times_s, fps, depth=True)
    try:
        stored = DepthEncoderConfig.from_video_info(feature.get("info"))
    except (TypeError, ValueError) as error:
        raise CEIError(
            f"{path}: how its depth is coded cannot be told from meta/info.json ({one_line(error)})."
        ) from error
    depth_m = np.asarray(
        dequantize_depth(
            codes,
            depth_min=stored.depth_min,
            depth_max=stored.depth_max,
            shift=stored.shift,
            use_log=stored.use_log,
            output_unit="m",
            output_tensor=False,
        )
    )
    depth_m[(codes == 0) | (codes == DEPTH_QMAX)] = 0
    return depth_m[:, 0]
