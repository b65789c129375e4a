"""Frames of a dataset's video files, by LeRobot's own decoding."""

from pathlib import Path

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
