"""An episode as a dataset stores it, wherever in the dataset that may be."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cei_converters.dataset.cameras import Clip
from cei_gym.arrays import Array


@dataclass(frozen=True)
class EncodedEpisode:
    """An episode as it is stored, or a part of its features.

    Attributes:
        table: a column each feature, but for those that say where in the dataset frames are, and for videos.
        statistics: of pictures alone, feature key to LeRobot's; those of numbers are found in the table as it is written.
        task: what it shows, in words.
        tasks: the same of each frame; None where they are alike.
        clips: feature key to the part of another dataset's video that is the episode's.
        videos: feature key to an MP4 file of the episode alone.
    """

    table: pa.Table
    statistics: Mapping[str, dict[str, Array]] = field(default_factory=dict[str, dict[str, Array]])
    task: str = ""
    tasks: Sequence[str] | None = None
    clips: Mapping[str, Clip] = field(default_factory=dict[str, Clip])
    videos: Mapping[str, bytes] = field(default_factory=dict[str, bytes])

    def joined(self, other: "EncodedEpisode") -> "EncodedEpisode":
        """This one with another's features of the same frames; what it shows stays, but for frames that the other knows more of."""
        table = self.table
        for key in other.table.column_names:
            table = table.append_column(key, other.table[key])
        return EncodedEpisode(
            table,
            {**self.statistics, **other.statistics},
            self.task,
            self.tasks or other.tasks,
            {**self.clips, **other.clips},
            {**self.videos, **other.videos},
        )


def encode_episode(columns: Mapping[str, Array], features: Mapping[str, dict[str, Any]], task: str) -> EncodedEpisode:
    """Values as a dataset stores them. Of numbers in rows this needs nothing of LeRobot's, whose import takes long.

    Args:
        columns: feature key to (T, ...) values of the feature's type; images as (T, H, W, 1 or 3).
        features: LeRobot's description of each column.
        task: what the episode shows, in words.
    """
    own = {key: feature for key, feature in features.items() if key in columns}
    table = pa.table({key: _arrow(columns[key], feature) for key, feature in own.items()})
    images = {key: feature for key, feature in own.items() if feature["dtype"] == "image"}
    return EncodedEpisode(table, {key: image_statistics(columns[key], each) for key, each in images.items()}, task)


def _arrow(values: Array, feature: Mapping[str, Any]) -> pa.Array:
    """As `datasets` has them by LeRobot's features, those of several dimensions as plain lists of lists, which a writer casts."""
    if feature["dtype"] == "image":
        return encode_images(values)
    shape = tuple(feature["shape"])
    if len(shape) == 1:
        flat = pa.array(values.astype(feature["dtype"], copy=False).ravel())
        return flat if shape == (1,) else pa.FixedSizeListArray.from_arrays(flat, shape[0])
    from datasets.features.features import numpy_to_pyarrow_listarray

    return numpy_to_pyarrow_listarray(values.reshape(len(values), *shape))


def image_statistics(values: Array, feature: Mapping[str, Any]) -> dict[str, Array]:
    """As LeRobot's `compute_episode_stats`, which reads images from files."""
    from lerobot.datasets.compute_stats import auto_downsample_height_width, get_feature_stats, sample_indices

    images = values[sample_indices(len(values))].transpose(0, 3, 1, 2)
    small = np.stack([auto_downsample_height_width(image) for image in images])
    stats = get_feature_stats(small, axis=(0, 2, 3), keepdims=True)
    largest = 1.0 if (feature.get("info") or {}).get("is_depth_map") else 255.0
    return {name: value if name == "count" else value[0] / largest for name, value in stats.items()}


def encode_images(images: Array) -> pa.Array:
    """(T, H, W, 1) depth as LeRobot's TIFF, (T, H, W, 3) pictures as its PNG, in the cells of `datasets.Image`."""
    from datasets import Image
    from lerobot.datasets.image_writer import image_array_to_pil_image, save_kwargs_for_path

    cells: list[dict[str, Any]] = []
    kind = "tiff" if images.shape[-1] == 1 else "png"
    for frame, image in enumerate(images):
        path, buffer = Path(f"frame-{frame:06d}.{kind}"), io.BytesIO()
        image_array_to_pil_image(image).save(buffer, format=kind.upper(), **save_kwargs_for_path(path, 1))
        cells.append({"bytes": buffer.getvalue(), "path": str(path)})
    return pa.array(cells, Image().pa_type)
