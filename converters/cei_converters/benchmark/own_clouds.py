"""A recorded dataset as a policy of its own robot is trained on it: joints as they are, clouds as cameras see them in the place of depth."""

from dataclasses import replace

import numpy as np

from cei_converters.cli import DatasetConfig
from cei_converters.dataset.metadata import Environment
from cei_converters.dataset.provenance import collect
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.sources.reader import DatasetReader
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError
from cei_gym.pointcloud import CloudOptions, crop, farthest_point_sample, frame_points


def with_own_clouds(recorded: DatasetConfig, new: DatasetConfig) -> None:
    """Write a dataset of the same demonstrations with clouds (`cei-convert` would move their joints, too).

    Args:
        recorded: with depth.
        new: which must not exist.

    Raises:
        CEIError: there is nothing that cameras saw, or a dataset in the way.
    """
    reader = DatasetReader(recorded.repo_id, recorded.root)
    environment = Environment() if reader.metadata is None else reader.metadata.environment
    with DatasetWriter(new.repo_id, new.root, environment=environment, provenance=collect({})) as writer:
        for index in range(len(reader)):
            demonstration = reader.read(index, colours=False)
            clouds = np.stack([_cloud(demonstration, t) for t in range(len(demonstration))])
            record = {key: value for key, value in reader.record(index).items() if key in ("seed", "success")}
            writer.add(replace(demonstration, depth_m={}, rgb={}, point_cloud_world=clouds), record)


def _cloud(demonstration: Demonstration, t: int) -> Array:
    """(K, 3) a frame's cloud, world, m, thinned as those of conversions are by default."""
    depth_m = {name: images[t] for name, images in demonstration.depth_m.items()}
    points = frame_points(demonstration.scene, depth_m, {}, None, colours=False)
    if points is None:
        raise CEIError(f"episode {demonstration.index} has no depth to make clouds of.")
    options = CloudOptions()
    return farthest_point_sample(
        points[crop(points, demonstration.scene.workspace_world)], options.points, options.seed
    )
