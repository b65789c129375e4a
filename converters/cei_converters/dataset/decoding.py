"""Pictures of a dataset: frames of its video files, by LeRobot's own decoding, and encoded images."""

import io
import math
from collections.abc import Mapping
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import av
import av.logging
import numpy as np
import pyarrow as pa
from av.error import FFmpegError

from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line


def check_video(path: Path) -> float:
    """Check that an MP4 file is whole, without decoding it; returns its length in seconds, infinity if it does not say.

    Raises:
        CEIError: it is no MP4, cut short, or without pictures.
    """
    status = path.stat()
    return _check_video(path, status.st_size, status.st_mtime_ns)


@cache
def _check_video(path: Path, _size: int, _changed_ns: int) -> float:
    av.logging.set_level(None)  # FFmpeg has lines of its own for what is said below
    try:
        # by its format: FFmpeg would follow a playlist to any file or host
        with closing(av.open(str(path), format="mp4")) as container:
            video = container.streams.video[0]
            whole = sum(packet.size > 0 and not packet.is_corrupt for packet in container.demux(video))
            frames, duration, time_base = video.frames, video.duration, video.time_base
    except (FFmpegError, ValueError, IndexError) as error:
        raise CEIError(
            f"{path} cannot be decoded as MP4 ({one_line(error)}); download or record the dataset again."
        ) from error
    if whole < max(frames, 1):
        raise CEIError(f"{path} is cut short: {whole} of {frames} frames; download or record the dataset again.")
    return float(duration * time_base) if duration and time_base else math.inf


def decode_frames(path: Path, times_s: Array, fps: float, *, depth: bool = False) -> Array:
    """Frames at (T,) times as (T, 3, H, W) uint8, or of a depth video as (T, 1, H, W) uint16 codes.

    Raises:
        CEIError: the file cannot be decoded at these times.
    """
    from lerobot.datasets.video_utils import decode_video_frames

    av.logging.set_level(None)
    try:
        # half a frame: the nearest one is meant, however its time was rounded
        frames = decode_video_frames(path, times_s.tolist(), 0.5 / fps, "pyav", return_uint8=True, is_depth=depth)
    except (FFmpegError, ValueError, IndexError, OSError) as error:
        raise CEIError(
            f"{path} cannot be decoded ({one_line(error)}); download or record the dataset again."
        ) from error
    return frames.numpy()


def decode_pictures(column: Any, feature: Mapping[str, Any], where: str) -> Array:
    """A column of encoded RGB images as (T, H, W, 3) uint8.

    Raises:
        CEIError: a cell is no picture of the feature's size.
    """
    from PIL import Image, UnidentifiedImageError

    pictures = np.empty((len(column), *feature["shape"]), np.uint8)
    for frame, encoded in enumerate(encoded_images(column, where)):
        try:
            pictures[frame] = np.asarray(Image.open(io.BytesIO(encoded)).convert("RGB"))
        except (UnidentifiedImageError, Image.DecompressionBombError, ValueError, OSError, SyntaxError) as error:
            size = "x".join(map(str, feature["shape"][1::-1]))
            raise CEIError(f"{where}: frame {frame} is no {size} picture ({one_line(error)}).") from error
    return pictures


def encoded_images(column: Any, where: str) -> list[bytes]:
    """The bytes of each image of a column, empty where there are none.

    Raises:
        CEIError: the column does not hold images.
    """
    kind = column.type
    if not pa.types.is_struct(kind) or kind.get_field_index("bytes") < 0:
        raise CEIError(f"{where} is stored as {one_line(kind, 60)}; it should be images, each with its bytes.")
    encoded = [(cell or {}).get("bytes") or b"" for cell in column.to_pylist()]
    if not all(isinstance(each, bytes) for each in encoded):
        raise CEIError(f"{where} is stored as {one_line(kind, 60)}; it should be images, each with its bytes.")
    return encoded
