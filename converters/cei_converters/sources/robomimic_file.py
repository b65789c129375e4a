"""What lies where in an HDF5 file of robosuite and robomimic, read and checked."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cei_converters.dataset.carried import OF_THE_ROBOT
from cei_converters.sources import hdf5
from cei_converters.sources.joint_map import JointMap
from cei_converters.sources.recording import Recording, Recordings, spread
from cei_converters.sources.robosuite import ACTIONS
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError

JOINTS = ("robot0_joint_pos", "robot0_gripper_qpos")
CLOUD, OBJECTS = "point_cloud", "object"
# of each frame, by robomimic's names, as LeRobot names and types them
CARRIED = {"rewards": ("next.reward", "float32"), "dones": ("next.done", "bool")}
NO_READER = "there is no reader for it in HDF5"


def data_of(file: h5py.File, root: Path) -> h5py.Group:
    found = hdf5.group_at(file, "data", root)
    if found is None:
        raise CEIError(f"{root} has no episodes: the group 'data' is missing or empty.")
    return found


def episode_names(file: h5py.File, root: Path) -> list[str]:
    data = data_of(file, root)
    names = hdf5.groups_in(data)
    if not names:
        raise CEIError(f"{root} has no episodes: the group 'data' is missing or empty.")
    return sorted(names, key=lambda name: (len(name), name))  # demo_10 comes after demo_9


def observations(episode: h5py.Group, root: Path) -> tuple[dict[str, h5py.Dataset], dict[str, str]]:
    """Datasets under `obs`, and why others there are not taken."""
    group = hdf5.group_at(episode, "obs", root)
    if group is None:
        name = (episode.name or "").rpartition("/")[2]
        raise CEIError(f"{root}, {name}, has no observations; make them with robomimic's dataset_states_to_obs.py.")
    return hdf5.datasets_in(group, root)


def number_columns(found: Mapping[str, h5py.Dataset]) -> dict[str, int]:
    """Observations with a row of numbers a frame: name to length."""
    return {name: data.shape[1] for name, data in found.items() if data.ndim == 2 and data.dtype.kind in "fiu"}


def joint_columns(
    columns: Mapping[str, int],
    found: Mapping[str, h5py.Dataset],
    elsewhere: Mapping[str, str],
    body: Embodiment,
    root: Path,
) -> dict[str, int]:
    for name in JOINTS:
        if name in columns:
            continue
        stored = (
            f"; it is stored as {found[name].dtype} of shape {found[name].shape}"
            if name in found
            else why_not(elsewhere, name)
        )
        raise CEIError(
            f"{root} lacks obs/{name} with a row of numbers a frame{stored}; it has: {', '.join(found)}. --joint_map may say what to take."
        )
    chosen = {name: columns[name] for name in JOINTS}
    recorded, wanted = sum(chosen.values()), len(body.joint_names)
    if recorded != wanted:
        raise CEIError(
            f"{root} has {recorded} joints but {body.name} has {wanted}; choose another --source, or say with --joint_map which is which."
        )
    return chosen


def why_not(elsewhere: Mapping[str, str], name: str) -> str:
    return f" (it is {elsewhere[name]})" if name in elsewhere else ""


def width_of(entries: h5py.Dataset | None, root: Path) -> int | None:
    if entries is None:
        return None
    if entries.ndim != 2 or entries.dtype.kind not in "fiu":
        raise CEIError(
            f"{root}: {entries.name} is {entries.dtype} of shape {entries.shape}; it should be rows of numbers."
        )
    return int(entries.shape[1])


def carried_by(episode: h5py.Group, root: Path) -> list[str]:
    return [
        name
        for name in CARRIED
        if isinstance(episode.get(name, getlink=True), h5py.HardLink)
        and hdf5.dataset_at(episode, name, root) is not None
    ]


def dropped_from(
    found: Mapping[str, h5py.Dataset], columns: Mapping[str, int], carried: Sequence[str], episode: h5py.Group
) -> dict[str, str]:
    """Name to reason of what is not taken."""
    used = {*columns, CLOUD, OBJECTS}
    observed = {name: OF_THE_ROBOT if data.ndim < 3 else NO_READER for name, data in found.items() if name not in used}
    others = [str(name) for name in episode if name not in ("obs", ACTIONS, *carried)]
    return observed | {
        name: NO_READER if name != "states" else "the simulator's, the source robot in it" for name in others
    }


def numbered_names(name: str, size: int) -> list[str]:
    return [f"{name}.{i}" for i in range(size)]


def task_of(data: h5py.Group, env: Mapping[str, Any]) -> str:
    """What episodes show, in words: LIBERO's instruction, else the environment's name."""
    said = hdf5.json_attribute(data, "problem_info").get("language_instruction")
    said = said if isinstance(said, str) else env.get("env_name")
    return said if isinstance(said, str) else ""


def fps_of(joint_map: JointMap | None, kwargs: Mapping[str, Any], root: Path) -> float:
    fps = (joint_map and joint_map.fps) or kwargs.get("control_freq")
    if not isinstance(fps, (int, float)) or isinstance(fps, bool) or not 0 < fps < 10_000:
        raise CEIError(f"{root} does not say how many frames a second it has; --joint_map can, by fps: 20.")
    return float(fps)


def recordings(root: Path, most: int) -> Recordings:
    """All columns that a joint map may use, of some episodes.

    Raises:
        CEIError: the file cannot be read.
    """
    with hdf5.opened(root) as file:
        names = episode_names(file, root)
        env = hdf5.json_attribute(data_of(file, root), "env_args")
        episodes, columns = [], {}
        for i in spread(len(names), most):
            episode = hdf5.group_at(data_of(file, root), names[i], root)
            assert episode is not None
            found, _ = observations(episode, root)
            columns = columns or number_columns(found)
            if missing := [name for name in columns if name not in found]:
                raise CEIError(f"{root}, {names[i]} lacks obs/{missing[0]}, which the first episode has.")
            episodes.append(
                Recording(i, np.column_stack([hdf5.read(found[name], root) for name in columns]).astype(float))
            )
    kwargs = env.get("env_kwargs")
    fps = kwargs.get("control_freq") if isinstance(kwargs, Mapping) else None
    numbered = [name for column, size in columns.items() for name in numbered_names(column, size)]
    return Recordings(numbered, fps, episodes, len(names))
