"""LeRobot's older formats, v2.0 and v2.1, by LeRobot's own conversion to v3.0, in a copy that is made once."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.dataset.hidden import link_visible
from cei_converters.dataset.home import lerobot_home
from cei_converters.dataset.license import CARD_PATH, copy_license_files, own_file
from cei_gym.arrays import Array
from cei_gym.errors import CEIError, one_line

VERSIONS = ("v2.0", "v2.1")
_META = ("episodes.jsonl", "tasks.jsonl", "episodes_stats.jsonl")
_KEPT = (CARD_PATH, "meta/modality.json")


def upgrade(root: Path, version: str) -> Path:
    """Folder of the same dataset as v3.0, in LeRobot's cache; the original stays as it is.

    LeRobot converts in place, and v2.1 alone; so it works on a folder of links, to which v2.0's missing statistics are added.
    Cameras without a single file are left out, as in GR00T's published datasets.

    Args:
        root: its folder.
        version: what it says it is.

    Raises:
        CEIError: it is not what it says, or LeRobot refuses it.
    """
    from cei_converters.dataset.place import temporary_folder
    from cei_converters.dataset.provenance import fingerprint

    if missing := [name for name in _META[:2] if not (root / "meta" / name).is_file()]:
        raise CEIError(f"{root} says that its codebase_version is {version}, but has no meta/{missing[0]}.")
    digest = fingerprint(root).partition(":")[2][:16]
    upgraded = lerobot_home() / "upgraded" / f"{root.resolve().name}-{digest}"
    if upgraded.is_dir():
        return upgraded
    print(f"{root} is of an older format; a v3.0 copy is made in {upgraded}.")
    upgraded.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(upgraded.parent) as folder:
        staged, made = folder / "v21", folder / "v30"
        try:
            _stage(root, staged)
            _convert(staged, made)
        except CEIError:
            raise
        except Exception as error:  # LeRobot's script checks little: whatever the dataset lacks surfaces somehow
            raise CEIError(
                f"{root} cannot be converted to v3.0 ({type(error).__name__}: {one_line(error)}); convert it with the LeRobot "
                "version that recorded it, then with `python -m lerobot.scripts.convert_dataset_v21_to_v30`."
            ) from error
        copy_license_files(root, made)
        for name in _KEPT:
            if own_file(root, root / name):
                shutil.copyfile(root / name, made / name)
        try:
            made.rename(upgraded)
        except OSError:
            if not upgraded.is_dir():  # else another process was faster
                raise
    return upgraded


def _stage(root: Path, staged: Path) -> None:
    """A v2.1 dataset of links."""
    (staged / "meta").mkdir(parents=True)
    for folder in ("data", "videos"):
        if (root / folder).is_dir():
            link_visible(root / folder, staged / folder)
    for name in _META:
        if (root / "meta" / name).is_file():
            shutil.copyfile(root / "meta" / name, staged / "meta" / name)
    info = json.loads((root / "meta/info.json").read_text())
    videos = [key for key, feature in info["features"].items() if feature["dtype"] == "video"]
    absent = [key for key in videos if not any((staged / "videos").glob(f"*/{key}/*.mp4"))]
    for key in absent:
        print(f"{root.name} declares {key} but has no file of it: left out.")
        del info["features"][key]
    info |= {"codebase_version": VERSIONS[-1], "total_chunks": 0, "total_videos": 0}
    info.setdefault("video_path", None)
    (staged / "meta/info.json").write_text(json.dumps(info))
    if not (staged / "meta/episodes_stats.jsonl").exists():
        _write_statistics(staged, info)


def _convert(staged: Path, made: Path) -> None:
    from lerobot.datasets.utils import DEFAULT_DATA_FILE_SIZE_IN_MB, DEFAULT_VIDEO_FILE_SIZE_IN_MB
    from lerobot.scripts import convert_dataset_v21_to_v30 as script

    sizes = DEFAULT_DATA_FILE_SIZE_IN_MB, DEFAULT_VIDEO_FILE_SIZE_IN_MB
    script.convert_info(staged, made, *sizes)
    script.convert_tasks(staged, made)
    episodes = script.convert_data(staged, made, sizes[0])
    videos = script.convert_videos(staged, made, sizes[1])
    script.convert_episodes_metadata(staged, made, episodes, videos)


def _write_statistics(staged: Path, info: dict[str, Any]) -> None:
    """v2.1's statistics of each episode, which v2.0 has of the whole dataset only."""
    paths = sorted((staged / "data").glob("*/*.parquet"))
    with (staged / "meta/episodes_stats.jsonl").open("w") as file:
        for index, path in enumerate(paths):
            statistics = _statistics(staged, path, index, info)
            plain = {key: {name: value.tolist() for name, value in stats.items()} for key, stats in statistics.items()}
            file.write(json.dumps({"episode_index": index, "stats": plain}) + "\n")


def _statistics(staged: Path, path: Path, index: int, info: dict[str, Any]) -> dict[str, dict[str, Array]]:
    import pyarrow.parquet as pq
    from lerobot.datasets.compute_stats import (
        DEFAULT_QUANTILES,
        compute_episode_stats,
        get_feature_stats,
        sample_indices,
    )

    from cei_converters.dataset.decoding import decode_frames, decode_pictures

    table, features = pq.read_table(path), info["features"]
    sampled = np.array(sample_indices(table.num_rows))
    numbers, pictures = {}, {}
    for key, feature in features.items():
        if feature["dtype"] == "video":
            (video,) = sorted((staged / "videos").glob(f"*/{key}/episode_{index:06d}.mp4")) or [staged / key]
            pictures[key] = decode_frames(video, sampled / info["fps"], info["fps"])
        elif feature["dtype"] == "image":
            found = decode_pictures(table[key].take(sampled), feature, f"episode {index}, {key}")
            pictures[key] = found.transpose(0, 3, 1, 2)
        elif feature["dtype"] != "string":
            numbers[key] = np.stack(table[key].to_numpy())
    statistics = compute_episode_stats(numbers, features)
    for key, frames in pictures.items():
        stats = get_feature_stats(frames, axis=(0, 2, 3), keepdims=True, quantile_list=DEFAULT_QUANTILES)
        # as LeRobot has those of pictures: (3, 1, 1), in [0, 1]
        statistics[key] = {k: v if k == "count" else np.squeeze(v / 255.0, axis=0) for k, v in stats.items()}
    return statistics
