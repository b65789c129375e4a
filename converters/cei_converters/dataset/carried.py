"""What a dataset has of each frame that does not depend on the robot: rewards, ends, language. It is carried over as it is."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from cei_converters.dataset import schema
from cei_converters.dataset.columns import decode_array, read_columns
from cei_converters.dataset.description import Description
from cei_converters.dataset.encoded import EncodedEpisode, encode_episode
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line

OF_EVERY_DATASET = ("timestamp", "frame_index", "episode_index", "index", "task_index")
TEXTS = ("string", "language")
OF_THE_ROBOT = "of the source robot"
_OBSERVED = ("observation", "observations", "obs", "action", "actions", "state", "robot", "leader", "follower")
_SAID = "annotation"  # as in GR00T's datasets: texts, and numbers of texts
_ROBOT_WORDS = frozenset(
    [
        "action",
        "actions",
        "state",
        "states",
        "qpos",
        "qvel",
        "qacc",
        "joint",
        "joints",
        "effort",
        "efforts",
        "torque",
        "torques",
        "velocity",
        "velocities",
        "vel",
        "acceleration",
        "current",
        "currents",
        "motor",
        "motors",
        "servo",
        "servos",
        "eef",
        "ee",
        "tcp",
        "gripper",
        "grippers",
        "finger",
        "fingers",
        "arm",
        "arms",
        "wrist",
        "elbow",
        "shoulder",
        "pose",
        "poses",
        "pos",
        "position",
        "positions",
        "cartesian",
        "wrench",
        "force",
        "forces",
        "tactile",
        "touch",
        "imu",
        "odom",
    ]
)


@dataclass(frozen=True)
class Carried:
    """What is carried over of one episode.

    Attributes:
        columns: feature key to (T, *shape) values, of texts as Arrow has them.
        tasks: of each frame, in words; None where all are the episode's.
    """

    columns: Mapping[str, Array | pa.Array] = field(default_factory=dict[str, Array | pa.Array])
    tasks: tuple[str, ...] | None = None

    def at(self, frames: Array | None) -> "Carried":
        """The same with frames at these indices, in this order; None changes nothing."""
        if frames is None:
            return self
        columns = {
            key: values[frames] if isinstance(values, np.ndarray) else values.take(pa.array(frames))
            for key, values in self.columns.items()
        }
        return Carried(columns, None if self.tasks is None else tuple(self.tasks[t] for t in frames))

    def check_frames(self, frames: int) -> None:
        """Check that all are of as many frames.

        Raises:
            CEIError: a column has more or fewer.
        """
        lengths = {key: len(values) for key, values in self.columns.items()}
        lengths |= {} if self.tasks is None else {"task_index": len(self.tasks)}
        for key, length in lengths.items():
            if length != frames:
                raise CEIError(
                    f"{key} has {length} frames, where the demonstration has {frames}; what cuts one should cut the other, by `at`."
                )

    def encode(self, features: Mapping[str, dict[str, Any]]) -> EncodedEpisode:
        """As a dataset with these features stores them."""
        numbers = {key: values for key, values in self.columns.items() if isinstance(values, np.ndarray)}
        table = encode_episode(numbers, features, "").table
        for key in features:
            if key in self.columns and key not in numbers:
                table = table.append_column(key, _plain(self.columns[key]))
        return EncodedEpisode(table, tasks=self.tasks)


def _plain(texts: Any) -> pa.Array:
    """Texts in one type, however the file has them: those of several files may become one."""
    texts = texts.dictionary_decode() if pa.types.is_dictionary(texts.type) else texts
    return texts.cast(pa.string()) if pa.types.is_large_string(texts.type) else texts


def choose(
    features: Mapping[str, dict[str, Any]], used: Iterable[str]
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """Which features are carried over, and why others are not.

    Whether a feature depends on the robot only its name can say: that of an observation or action does, or of joints, poses
    or forces; texts, annotations and all others do not.

    Args:
        features: LeRobot's, of a dataset.
        used: keys of those that become something else.

    Returns:
        Those to carry, and of the others key to reason.
    """
    carried, dropped = {}, {}
    for key, feature in features.items():
        if key in used or key in OF_EVERY_DATASET:
            continue
        if reason := _why_not(key, feature):
            dropped[key] = reason
        else:
            carried[key] = {**feature, "shape": tuple(feature["shape"])}
    return carried, dropped


def _why_not(key: str, feature: Mapping[str, Any]) -> str:
    dtype, shape = feature["dtype"], feature["shape"]
    first, *_ = key.split(".")
    if dtype not in TEXTS:
        try:
            numeric = np.dtype(dtype).kind in "biuf"
        except TypeError:
            numeric = False
        if not numeric or not 1 <= len(shape) <= 5:
            return f"stored as {dtype} of shape {tuple(shape)}, which cannot be written"
        if first in _OBSERVED:
            return OF_THE_ROBOT
        words = {word for name in (key, *schema.feature_names(feature)) for word in schema.words(name)}
        if first != _SAID and (named := words & _ROBOT_WORDS):
            return f"{OF_THE_ROBOT}, as {sorted(named)[0]!r} in its name says"
    return ""


def of_episodes(meta: Description) -> dict[str, str]:
    """Name to reason of what is known of whole episodes in meta/episodes beyond LeRobot's own, which is written anew."""
    own = {"episode_index", "tasks", "length", "dataset_from_index", "dataset_to_index"}
    names = [name for name in meta.episodes.column_names if name not in own]
    return {
        f"meta/episodes: {name}": "of whole episodes, whose table is written anew"
        for name in names
        if not name.startswith(("data/", "meta/episodes/", "videos/", "stats/"))
    }


def with_objects_moved(carried: Mapping[str, dict[str, Any]]) -> dict[str, str]:
    """Key to reason of what does not hold any more where objects are elsewhere."""
    reason = "may say where objects are, which are moved"
    return {
        key: reason
        for key, feature in carried.items()
        if feature["dtype"].startswith("float") and tuple(feature["shape"]) != (1,)
    }


def read_carried(
    root: Path, meta: Description, index: int, features: Mapping[str, dict[str, Any]], tasks: Mapping[int, str]
) -> Carried:
    """What is carried over of an episode.

    Args:
        root: the dataset's folder.
        meta: what it says of itself.
        index: the episode.
        features: those that are carried.
        tasks: task_index to words.

    Raises:
        CEIError: a value is missing, of another type or shape, or of a task that there is not.
    """
    table = read_columns(root, meta, index, [*features, "task_index"])
    columns = {key: _values(table[key], features[key], f"episode {index}, {key}") for key in features}
    return Carried(columns, frame_tasks(table, tasks, index))


def frame_tasks(table: pa.Table, tasks: Mapping[int, str], index: int) -> tuple[str, ...] | None:
    """The task of each frame of an episode, in words; None where frames do not say.

    Raises:
        CEIError: there is no such task.
    """
    if "task_index" not in table.column_names:
        return None
    said: list[str] = []
    for frame, number in enumerate(table["task_index"].to_pylist()):
        number = number[0] if isinstance(number, list) and len(number) == 1 else number
        if (whole := whole_number(number)) is None or whole not in tasks:
            raise CEIError(
                f"episode {index}, frame {frame}: task_index is {one_line(number, 40)}, but meta/tasks.parquet has {_range(sorted(tasks))}; download "
                "or record the dataset again."
            )
        said.append(tasks[whole])
    return tuple(said)


def whole_number(value: object) -> int | None:
    """A number that is whole, however it is stored; None for anything else."""
    number = value.item() if isinstance(value, np.generic) else value
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not float(number).is_integer():
        return None
    return int(number)


def _range(numbers: Sequence[int]) -> str:
    return f"{numbers[0]} to {numbers[-1]}" if numbers else "none"


def _values(column: pa.ChunkedArray, feature: Mapping[str, Any], where: str) -> Array | pa.Array:
    if feature["dtype"] in TEXTS:
        return column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)
    if column.null_count:
        raise CEIError(
            f"{where}: {column.null_count} frames have no value, which cannot be carried over; leave it out with --drop_features={where.split(', ')[1]}."
        )
    values = decode_array(column, feature, where, boolean=feature["dtype"] == "bool")
    try:
        return values.astype(feature["dtype"], casting="same_kind")
    except TypeError as error:
        raise CEIError(f"{where} is stored as {values.dtype}, but meta/info.json says {feature['dtype']}.") from error
