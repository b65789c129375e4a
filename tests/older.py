"""Datasets in the layouts of earlier versions, as those wrote them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment

VERSIONS = ("1.0", "1.1")
STATE, ACTION = "observation.state", "action"
CLOUD, OBJECTS = "observation.point_cloud", "observation.environment_state"


def write(
    root: Path,
    version: str,
    episodes: Sequence[Demonstration],
    records: Sequence[dict[str, Any]],
    environment: dict[str, Any],
    provenance: dict[str, Any],
) -> None:
    """Write demonstrations by LeRobot's own writer: clouds of two dimensions, objects where policies look, nothing in `features`."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    first = episodes[0]
    assert first.point_cloud_world is not None and first.environment_state is not None
    body = load_embodiment(first.embodiment)
    names = [f"{joint}.pos_{unit}" for joint, unit in zip(body.joint_names, body.joint_units, strict=True)]
    joints = {"dtype": "float32", "shape": (len(names),), "names": names}
    objects = list(first.environment_state_names)
    features = {
        STATE: joints,
        ACTION: joints,
        CLOUD: {"dtype": "float32", "shape": first.point_cloud_world.shape[1:], "names": ["point", "xyz_m"]},
        OBJECTS: {"dtype": "float32", "shape": (len(objects),), "names": objects},
    }
    dataset = LeRobotDataset.create(
        "me/older", fps=int(first.fps), features=features, root=root, robot_type=first.embodiment, use_videos=False
    )
    for episode in episodes:
        assert episode.point_cloud_world is not None and episode.environment_state is not None
        for t in range(len(episode)):
            values = {STATE: episode.qpos[t], ACTION: episode.action[t], OBJECTS: episode.environment_state[t]}
            frame = {key: value.astype(np.float32) for key, value in values.items()}
            dataset.add_frame({**frame, CLOUD: episode.point_cloud_world[t].astype(np.float32), "task": episode.task})
        dataset.save_episode()
    dataset.finalize()
    scene = first.scene
    cameras = [
        {
            "name": camera.name,
            "width": camera.width,
            "height": camera.height,
            "K": camera.K.tolist(),
            "T_world_camera": camera.T_world_camera.tolist(),
        }
        for camera in scene.cameras
    ]
    described = {
        "embodiment": first.embodiment,
        "scene": {
            "T_world_base": scene.T_world_base.tolist(),
            "cameras": cameras,
            "workspace_world": scene.workspace_world.tolist(),
        },
        "environment": environment,
        "provenance": provenance,
        "conventions": {"point_cloud": "world frame, metres, cropped to scene.workspace_world"},
        "format_version": version,
    }
    if version == "1.0":
        described["episodes"] = list(records)
    else:
        lines = "".join(json.dumps(record) + "\n" for record in records)
        (root / "meta/cei_episodes.jsonl").write_text(lines)
    (root / "meta/cei.json").write_text(json.dumps(described))


def forget(root: Path) -> None:
    """Take away what `features` of a dataset of today carry of its `meta/cei.json`, as in one of format 1.1."""
    info = json.loads((root / "meta/info.json").read_text())
    for key in (STATE, ACTION):
        del info["features"][key]["info"]["cei"]
    (root / "meta/info.json").write_text(json.dumps(info))
