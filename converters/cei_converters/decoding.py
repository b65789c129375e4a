"""Pictures of a dataset: frames of its video files, by LeRobot's own decoding, and encoded images."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from av.error import FFmpegError

from cei_gym.errors import CEIError, one_line


def decode_frames(path: Path, times_s: np.ndarray, fps: float, *, depth: bool = False) -> np.ndarray:
    """Frames at (T,) times as (T, 3, H, W) uint8, or of a depth video as (T, 1, H, W) uint16 codes.

    Raises:
        CEIError: the file cannot be decoded at these times.
    """
    from lerobot.datasets.video_utils import decode_video_frames

    try:
        # half a frame: the nearest one is meant, however its time was rounded
        frames = decode_video_frames(path, times_s.tolist(), 0.5 / fps, "pyav", return_uint8=True, is_depth=depth)
    except (FFmpegError, ValueError, IndexError, OSError) as error:
        raise CEIError(
            f"{path} cannot be decoded ({one_line(error)}); download or record the dataset again."
        ) from error
    return frames.numpy()


def decode_pictures(column: Any, feature: Mapping[str, Any], where: str) -> np.ndarray:
    """A column of encoded RGB images as (T, H, W, 3) uint8.

    Raises:
        CEIError: a cell is no picture of the feature's size.
    """
    from PIL import Image, UnidentifiedImageError

    pictures = np.empty((len(column), *feature["shape"]), np.uint8)
    for frame, cell in enumerate(column):
        try:
            pictures[frame] = np.asarray(Image.open(io.BytesIO(cell["bytes"].as_py())).convert("RGB"))
        except (UnidentifiedImageError, TypeError, ValueError, OSError) as error:
            size = "x".join(map(str, feature["shape"][1::-1]))
            raise CEIError(f"{where}: frame {frame} is no {size} picture ({one_line(error)}).") from error
    return pictures
