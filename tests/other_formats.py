"""Demonstrations of a Panda in other formats: robomimic's HDF5, LeRobot's v2.1, DemoGen's zarr."""

import json
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zarr

from cei_converters.dataset.schema import joint_feature_names
from cei_gym.embodiment import load_embodiment

ROBOT = "Panda-PandaGripper"
BODY = load_embodiment(ROBOT)


def path_of(frames: int, seed: int = 0) -> np.ndarray:
    """(T, n) a random walk around home."""
    steps = np.random.default_rng(seed).normal(0, 0.02, (frames, len(BODY.coupled.independent)))
    u = BODY.coupled.reduce(BODY.home) + np.cumsum(steps, axis=0)
    return BODY.coupled.expand(np.clip(u, *BODY.independent_limits))


def told(qpos: np.ndarray) -> np.ndarray:
    """(T,) robosuite's command to a gripper that moves like this: -1 to open, 1 to close."""
    return np.where(np.append(np.diff(qpos[:, 7]), 0) < 0, 1.0, -1.0)


def write_robomimic(path: Path) -> None:
    """Three demonstrations as robomimic has them."""
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps(
            {"env_name": "Lift", "env_kwargs": {"control_freq": 20, "robots": ["Panda"]}}
        )
        for i in (0, 2, 10):
            qpos, obs = path_of(6 + i, seed=i), data.create_group(f"demo_{i}/obs")
            obs["robot0_joint_pos"], obs["robot0_gripper_qpos"] = qpos[:, :7], qpos[:, 7:]
            data[f"demo_{i}/actions"] = np.column_stack([np.zeros((len(qpos), 6)), told(qpos)])
            obs["object"] = np.full((len(qpos), 3), float(i))
            obs["agentview_image"] = np.zeros((len(qpos), 4, 4, 3), np.uint8)


def write_v21(root: Path) -> None:
    """A v2.1 dataset, by hand: what LeRobot 0.1 to 0.3 wrote."""
    (root / "meta").mkdir(parents=True)
    names, start = joint_feature_names(BODY), 0
    feature = {"dtype": "float32", "shape": [9], "names": names}
    own = {
        key: {"dtype": "int64", "shape": [1], "names": None}
        for key in ("frame_index", "episode_index", "index", "task_index")
    }
    features = {
        "observation.state": feature,
        "action": feature,
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    }
    for index in range(3):
        qpos = path_of(6 + index, seed=index).astype(np.float32)
        column = pa.FixedSizeListArray.from_arrays(pa.array(qpos.ravel()), 9)
        count = np.arange(len(qpos))
        table = {
            "observation.state": column,
            "action": column,
            "timestamp": pa.array((count / 20).astype(np.float32)),
            "frame_index": count,
            "episode_index": np.full(len(qpos), index),
            "index": start + count,
            "task_index": np.zeros(len(qpos), int),
        }
        start += len(qpos)
        path = root / f"data/chunk-000/episode_{index:06d}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(table), path)
        with (root / "meta/episodes.jsonl").open("a") as file:
            file.write(json.dumps({"episode_index": index, "tasks": ["pick"], "length": len(qpos)}) + "\n")
    (root / "meta/tasks.jsonl").write_text(json.dumps({"task_index": 0, "task": "pick"}) + "\n")
    info = {
        "codebase_version": "v2.0",
        "robot_type": "panda",
        "total_episodes": 3,
        "total_frames": start,
        "total_tasks": 1,
        "total_videos": 0,
        "total_chunks": 1,
        "chunks_size": 1000,
        "fps": 20,
        "splits": {"train": "0:3"},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": None,
        "features": features | own,
    }
    (root / "meta/info.json").write_text(json.dumps(info))


def write_zarr(root: Path, state: np.ndarray, ends: list[int], **more: np.ndarray) -> None:
    """Demonstrations as DemoGen has them: their states, and where each ends."""
    group = zarr.open_group(root, mode="w", zarr_format=2)
    for name, values in {"data/state": state, "meta/episode_ends": np.array(ends), **more}.items():
        group.create_array(name, data=values)
