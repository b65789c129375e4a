"""Open what describes a dataset: LeRobot's metadata, ours, and the embodiment that they name."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from cei_converters.dataset import schema
from cei_converters.dataset.carried import whole_number
from cei_converters.dataset.description import EPISODES_FOLDER, TASKS_PATH, Description
from cei_converters.dataset.essentials import difference, find_essentials
from cei_converters.dataset.hidden import visible
from cei_converters.dataset.info import check_episodes, check_info
from cei_converters.dataset.locate import INFO_PATH, read_info
from cei_converters.dataset.metadata import METADATA_PATH, REQUIRED, Metadata, restore_with
from cei_gym.embodiment import (
    Embodiment,
    arm_names,
    check_embodiment,
    embodiment_names,
    end_effector_names,
    load_embodiment,
)
from cei_gym.errors import CEIError, one_line


def find_metadata(root: Path) -> Metadata | None:
    """What a dataset's folder says of it: `meta/cei.json`, else what LeRobot's tools have left (`essentials`); None if it says nothing.

    Raises:
        CEIError: what it says is wrong, or contradicts itself.
    """
    info = read_info(root) if (root / INFO_PATH).is_file() else {}
    carried = find_essentials(info.get("features"), f"{root.name}/{INFO_PATH}")
    if not (root / METADATA_PATH).is_file():
        return carried
    metadata = Metadata.load(root)
    if carried is not None and (differing := difference(carried, metadata)):
        raise CEIError(
            f"{root}: {METADATA_PATH} and {INFO_PATH} disagree about {differing}; remove the former if it is another dataset's. "
            f"{restore_with(root)}"
        )
    written_for, total = metadata.total_episodes, info.get("total_episodes")
    if carried is None or written_for in (None, total):
        return metadata
    print(f"{METADATA_PATH} of {root} is of {written_for} episodes, not of its {total}: ignored. {restore_with(root)}")
    return carried


def load_metadata(root: Path, embodiment: str | None) -> Metadata | None:
    """What a dataset's folder says of it; None if it says nothing and an embodiment is given instead.

    Raises:
        CEIError: it is wrong, or missing and not replaced.
    """
    metadata = find_metadata(root)
    if metadata is None and embodiment is None:
        raise CEIError(
            f"{root} has no {METADATA_PATH}; it needs {REQUIRED}. "
            f"Without it, name the robot with --source=<Arm>-<EndEffector>, of {', '.join(arm_names())}, and of {', '.join(end_effector_names())}, and calibrate depth "
            "cameras, if there are any, with --calibration=FILE.yaml."
            + (f" {restore_with(root)}" if read_info(root).get("robot_type") in embodiment_names() else "")
        )
    return metadata


def has_flat_clouds(root: Path) -> bool:
    """Whether a dataset, by its `meta/info.json`, has clouds that are flat; it is looked at closer where it is read."""
    features = read_info(root).get("features") if (root / INFO_PATH).is_file() else None
    cloud = features.get(schema.POINT_CLOUD) if isinstance(features, dict) else None
    shape = cloud.get("shape") if isinstance(cloud, dict) else None
    return isinstance(shape, list) and len(shape) == 1


def choose_embodiment(root: Path, metadata: Metadata | None, given: str | None) -> Embodiment:
    """The embodiment that the metadata names, or the given one.

    Raises:
        CEIError: it is unknown, or the two differ.
    """
    for name in (given, metadata.embodiment if metadata is not None else None):
        if name is not None:
            check_embodiment(name)
    if metadata is not None and given is not None and given != metadata.embodiment:
        raise CEIError(f"{root} is a dataset of {metadata.embodiment}, not of {given}; leave --source out.")
    name = metadata.embodiment if metadata is not None else given
    assert name is not None
    return load_embodiment(name)


def embodiment_without_metadata(path: Path, given: str | None) -> Embodiment:
    """The given embodiment, of a format that has no `meta/cei.json`.

    Raises:
        CEIError: none is given, or it is unknown.
    """
    if given is None:
        raise CEIError(
            f"{path} does not say which robot it is of; name it with --source=<Arm>-<EndEffector>, or in --joint_map."
        )
    return load_embodiment(given)


def describe(root: Path) -> Description:
    """What a dataset's `meta/` says of it, checked.

    Raises:
        CEIError: a file is missing, damaged or wrong, or there are no episodes.
    """
    for path in (EPISODES_FOLDER, TASKS_PATH, "data"):
        if not (root / path).exists():
            raise CEIError(f"{root} is no complete v3.0 dataset: {path} is missing.")
    if not visible(root, f"{EPISODES_FOLDER}/*/*.parquet"):
        raise CEIError(f"{root} is no complete v3.0 dataset: {EPISODES_FOLDER} has no Parquet file.")
    check_info(read_info(root), str(root / INFO_PATH))
    for path in visible(root, "meta/**/*.parquet"):
        try:
            pq.read_metadata(path)
        except (OSError, ValueError) as error:
            raise CEIError(
                f"{path} cannot be read ({one_line(error)}); download or record the dataset again."
            ) from error
    try:
        found = Description(root)
        _, _ = found.tasks, found.statistics
    except (OSError, ValueError, KeyError, pa.ArrowException) as error:
        raise CEIError(
            f"{root}/meta cannot be read ({one_line(error)}); download or record the dataset again."
        ) from error
    if found.total_episodes == 0:
        raise CEIError(f"{root} has no episodes: total_episodes in {INFO_PATH} is 0.")
    check_episodes(found.episodes, found.total_episodes, root)
    return found


def task_texts(described: Description) -> dict[int, str]:
    """What each task_index stands for, in words.

    Raises:
        CEIError: `meta/tasks.parquet` does not say.
    """
    table, found = described.tasks, {}
    columns = [next((name for name in names if name in table.column_names), None) for names in _TASK_COLUMNS]
    texts, numbers = ([None] * len(table) if name is None else table[name].to_pylist() for name in columns)
    for text, number in zip(texts, numbers, strict=True):
        whole = whole_number(number)
        if not isinstance(text, str) or whole is None or whole in found:
            raise CEIError(
                f"{described.root / TASKS_PATH}: {one_line(text, 60)!r} has task_index {one_line(number, 60)}; it should have a text for each whole "
                "number, once; download or record the dataset again."
            )
        found[whole] = text
    return found


_TASK_COLUMNS = (("task", "__index_level_0__"), ("task_index",))
"""Where texts and numbers are: LeRobot has the former as the index of a pandas table, whose name may be lost."""
