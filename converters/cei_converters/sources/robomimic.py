"""Read demonstrations of robosuite and robomimic: one HDF5 file, one group an episode."""

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cei_converters.dataset.opening import embodiment_without_metadata
from cei_converters.sources.calibration import Calibration
from cei_converters.sources.joint_map import JointMap, bind
from cei_converters.sources.recording import Recording, Recordings, spread
from cei_converters.sources.source import Source, check_cloud, scene_without_metadata
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError, one_line

_JOINTS = ("robot0_joint_pos", "robot0_gripper_qpos")
_CLOUD, _OBJECTS = "point_cloud", "object"


class RobomimicSource(Source):
    """Episodes of an HDF5 file as robomimic lays it out, with observations.

    Positions are `obs/robot0_joint_pos` and `obs/robot0_gripper_qpos`; with a joint map, columns are named after all of `obs`
    that has one row of numbers a frame, such as `robot0_eef_pos.0`. Actions are those of an operational-space controller, so that
    the next frame's state stands for them.

    Args:
        repo_id, root, embodiment, T_world_base, calibration, joint_map: see `open_source`.

    Raises:
        CEIError: whatever is wrong with the file, in one line.
    """

    def __init__(
        self,
        repo_id: str,
        root: str | Path,
        *,
        embodiment: str | None = None,
        T_world_base: np.ndarray | None = None,
        calibration: Calibration | None = None,
        joint_map: JointMap | None = None,
    ) -> None:
        self.repo_id, self.root = repo_id, Path(root)
        self.embodiment = embodiment_without_metadata(self.root, embodiment)
        self.scene = scene_without_metadata(T_world_base, calibration)
        with _open(self.root) as file:
            self._names = _episode_names(file, self.root)
            env = _env_args(file["data"].attrs.get("env_args"))
            first = _observations(file, self._names[0], self.root)
            columns = _columns(first) if joint_map is not None else self._joint_columns(first)
            self.has_clouds = _CLOUD in first
            names = [numbered for name, size in columns.items() for numbered in _numbered(name, size)]
        self._columns = list(columns)
        self.fps = _fps(joint_map, env, self.root)
        self._task = str(env.get("env_name", ""))
        self._bound = None if joint_map is None else bind(joint_map, self.embodiment, names)
        used = {*self._columns, _CLOUD, _OBJECTS}
        self.ignored_features = [name for name in first if name not in used]

    def __len__(self) -> int:
        return len(self._names)

    def frames(self, index: int) -> int:
        """Frames of an episode, without reading it."""
        with _open(self.root) as file:
            return len(_observations(file, self._names[index], self.root)[self._columns[0]])

    def read(self, index: int, *, clouds: bool = True, colours: bool = True) -> Demonstration:
        """One episode; see `Source.read`."""
        self.select([index])
        with _open(self.root) as file:
            found = _observations(file, self._names[index], self.root)
            try:
                state = np.column_stack([found[name][()] for name in self._columns])
                objects = found[_OBJECTS][()].astype(np.float64) if _OBJECTS in found else None
                cloud = found[_CLOUD][()] if clouds and self.has_clouds else None
            except (KeyError, OSError, ValueError, TypeError) as error:
                raise CEIError(f"{self.root}, episode {index}, cannot be read ({one_line(error)}).") from error
        joints = self.joints(state, None, index, self._bound)
        return Demonstration(
            embodiment=self.embodiment.name,
            fps=self.fps,
            qpos=joints.qpos,
            action=joints.action,
            scene=self.scene,
            task=self._task,
            point_cloud_world=None if cloud is None else check_cloud(cloud, len(state), f"episode {index}"),
            environment_state=objects,
            environment_state_names=() if objects is None else tuple(_numbered(_OBJECTS, objects.shape[1])),
            index=index,
            figures=joints.figures,
        )

    def _joint_columns(self, found: dict[str, Any]) -> dict[str, int]:
        if missing := [name for name in _JOINTS if name not in found]:
            raise CEIError(
                f"{self.root} lacks obs/{missing[0]}; it has: {', '.join(found)}. --joint_map may say what to take."
            )
        columns = {name: _columns(found).get(name, 0) for name in _JOINTS}
        recorded, wanted = sum(columns.values()), len(self.embodiment.joint_names)
        if recorded != wanted:
            raise CEIError(
                f"{self.root} has {recorded} joints but {self.embodiment.name} has {wanted}; choose another --source, or say with "
                "--joint_map which is which."
            )
        return columns


def _open(root: Path) -> h5py.File:
    try:
        return h5py.File(root, "r")
    except OSError as error:
        raise CEIError(f"{root} cannot be read as HDF5 ({one_line(error)}).") from error


def _episode_names(file: h5py.File, root: Path) -> list[str]:
    groups = file.get("data")
    if not isinstance(groups, h5py.Group) or not len(groups):
        raise CEIError(f"{root} has no episodes: the group 'data' is missing or empty.")
    return sorted(groups, key=lambda name: (len(name), name))  # demo_10 comes after demo_9


def _observations(file: h5py.File, episode: str, root: Path) -> dict[Any, Any]:
    """Datasets under `obs`, none of them in another file."""
    group = file.get(f"data/{episode}/obs")
    if not isinstance(group, h5py.Group):
        raise CEIError(f"{root}, {episode}, has no observations; make them with robomimic's dataset_states_to_obs.py.")
    inside = [name for name in group if isinstance(group.get(name, getlink=True), h5py.HardLink)]
    return {name: data for name in inside if isinstance(data := group[name], h5py.Dataset) and not data.external}


def _columns(found: dict[str, Any]) -> dict[str, int]:
    """Observations with a row of numbers a frame: name to length."""
    return {name: data.shape[1] for name, data in found.items() if data.ndim == 2 and data.dtype.kind in "fiu"}


def _numbered(name: str, size: int) -> list[str]:
    return [f"{name}.{i}" for i in range(size)]


def _env_args(text: Any) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (TypeError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _fps(joint_map: JointMap | None, env: dict[str, Any], root: Path) -> float:
    kwargs = env.get("env_kwargs")
    fps = (joint_map and joint_map.fps) or (kwargs.get("control_freq") if isinstance(kwargs, dict) else None)
    if not isinstance(fps, (int, float)) or not 0 < fps < 10_000:
        raise CEIError(f"{root} does not say how many frames a second it has; --joint_map can, by fps: 20.")
    return float(fps)


def recordings(root: Path, most: int) -> Recordings:
    """All columns that a joint map may use, of some episodes.

    Raises:
        CEIError: the file cannot be read.
    """
    with _open(root) as file:
        names = _episode_names(file, root)
        env, first = _env_args(file["data"].attrs.get("env_args")), _observations(file, names[0], root)
        columns = _columns(first)
        episodes = [
            Recording(np.column_stack([found[name][()] for name in columns]).astype(float))
            for found in (_observations(file, names[i], root) for i in spread(len(names), most))
        ]
    kwargs = env.get("env_kwargs")
    fps = kwargs.get("control_freq") if isinstance(kwargs, dict) else None
    numbered = [name for column, size in columns.items() for name in _numbered(column, size)]
    return Recordings(numbered, fps, episodes, len(names))
