"""Pictures of an episode become what a dataset stores: encoded where frames repeat in a video or were painted, else as they are."""

import tempfile
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import pyarrow as pa

from cei_converters.dataset.cameras import Pictures
from cei_converters.dataset.encoded import EncodedEpisode, encode_images, image_statistics
from cei_gym.arrays import Array

VIDEO_ENCODER = "lerobot.datasets.video_utils"
"""What encodes videos, and takes six seconds to import."""


def encode_pictures(pictures: Pictures, fps: float, scratch: Path) -> EncodedEpisode:
    """What cameras saw of an episode, as a dataset stores it.

    Args:
        pictures: what they saw.
        fps: frames a second.
        scratch: folder for files that are removed again.

    Raises:
        CEIError: a video cannot be decoded.
    """
    columns = dict(pictures.images)
    statistics = dict(pictures.statistics)
    clips = {key: clip for key, clip in pictures.clips.items() if clip.frames is None}
    videos = {
        key: _video(clip.decode(), pictures.features[key], fps, scratch)
        for key, clip in pictures.clips.items()
        if clip.frames is not None
    }
    for key, painted in pictures.painted.items():
        feature = pictures.features[key]
        statistics[key] = image_statistics(painted, feature)
        if feature["dtype"] == "image":
            columns[key] = encode_images(painted)
        else:
            videos[key] = _video(painted, feature, fps, scratch)
    return EncodedEpisode(pa.table(columns), statistics, clips=clips, videos=videos)


def _video(pictures: Array, feature: Mapping[str, Any], fps: float, scratch: Path) -> bytes:
    """(T, H, W, 3) uint8 pictures as an MP4 file, encoded as others of the feature are."""
    from lerobot.configs.video import encoder_config_from_video_info, rgb_encoder_defaults
    from lerobot.datasets.image_writer import write_image
    from lerobot.datasets.video_utils import encode_video_frames

    try:
        encoder = encoder_config_from_video_info(feature.get("info"))
    except ValueError:  # a codec that can be read here but not written
        encoder = rgb_encoder_defaults()
    scratch.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        for i, picture in enumerate(pictures):
            write_image(picture, Path(folder, f"frame-{i:06d}.png"))
        rate = int(fps) if fps == int(fps) else Fraction(fps).limit_denominator(1001)
        video = Path(folder, "video.mp4")
        encode_video_frames(folder, video, rate, encoder)  # pyright: ignore[reportArgumentType]  (FFmpeg's rates are fractions)
        return video.read_bytes()
