"""Read demonstrations of robosuite and robomimic: one HDF5 file, one group an episode."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa

from cei_converters.dataset.carried import Carried
from cei_converters.dataset.metadata import Environment
from cei_converters.dataset.opening import embodiment_without_metadata
from cei_converters.sources import hdf5
from cei_converters.sources.actions import BoundActions, action_map, bind_actions
from cei_converters.sources.binding import bind
from cei_converters.sources.calibration import Calibration
from cei_converters.sources.checks import check_cloud
from cei_converters.sources.joint_map import ActionMap, JointMap
from cei_converters.sources.robomimic_file import (
    CARRIED,
    CLOUD,
    OBJECTS,
    carried_by,
    data_of,
    dropped_from,
    episode_names,
    fps_of,
    joint_columns,
    number_columns,
    numbered_names,
    observations,
    task_of,
    why_not,
    width_of,
)
from cei_converters.sources.robosuite import ACTIONS, action_entries
from cei_converters.sources.scene import scene_without_metadata, table_from
from cei_converters.sources.simulated import STATES, SimulatedTask, same_place, simulated_task
from cei_converters.sources.source import Source
from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration
from cei_gym.errors import CEIError


@dataclass(frozen=True)
class _Layout:
    """What a file's first episode has, which all others must have, too: observations' name to length, and how many entries actions
    have."""

    columns: dict[str, int]
    actions: int | None


class RobomimicSource(Source):
    """Episodes of an HDF5 file as robomimic lays it out, with observations.

    Positions are `obs/robot0_joint_pos` and `obs/robot0_gripper_qpos`; with a joint map, columns are named after all of `obs`
    that has one row of numbers a frame, such as `robot0_eef_pos.0`. Of `actions` the gripper's command is taken, and the arm's where
    its controller takes absolute joint positions (`robosuite`); else the next frame's state stands for them.

    Where there is an environment of the task that `env_args` name, the simulator's states are those of its objects, and the model says where
    the robot's base and the table are (`simulated`).

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
        T_world_base: Array | None = None,
        calibration: Calibration | None = None,
        joint_map: JointMap | None = None,
    ) -> None:
        self.repo_id, self.root = repo_id, Path(root)
        self.embodiment = body = embodiment_without_metadata(self.root, embodiment)
        self.scene = scene_without_metadata(T_world_base, calibration)
        self.table_from = table_from(calibration)
        by_map = joint_map is not None and bool(joint_map.joints or joint_map.pose)
        with hdf5.opened(self.root) as file:
            self._names = episode_names(file, self.root)
            env = hdf5.json_attribute(data_of(file, self.root), "env_args")
            episode = self._episode(file, 0)
            found, elsewhere = observations(episode, self.root)
            columns = number_columns(found)
            if not by_map:
                columns = joint_columns(columns, found, elsewhere, body, self.root)
            entries = hdf5.dataset_at(episode, ACTIONS, self.root)
            self._layout = _Layout(columns, width_of(entries, self.root))
            self.has_clouds = CLOUD in found
            self._carried_as = carried_by(episode, self.root)
            self.dropped = elsewhere | dropped_from(found, columns, list(self._carried_as), episode)
            self._task = task_of(data_of(file, self.root), env)
            self._simulated: SimulatedTask | None = None
            if STATES in self.dropped:
                self._simulate(env, episode, len(found[next(iter(columns))]), T_world_base, calibration)
        kwargs = env.get("env_kwargs")
        kwargs = kwargs if isinstance(kwargs, Mapping) else {}
        self.fps = fps_of(joint_map, kwargs, self.root)
        names = [numbered for name, size in columns.items() for numbered in numbered_names(name, size)]
        self._bound = bind(joint_map, body, names) if by_map and joint_map is not None else None
        self._actions = self._bind_actions(joint_map, kwargs, names)
        self.quick = self._bound is None or self._bound.pose is None
        self.carried = {
            key: {"dtype": dtype, "shape": (1,), "names": None}
            for key, dtype in (CARRIED[name] for name in self._carried_as)
        }

    @property
    def environment(self) -> Environment:
        """See `Source.environment`."""
        return Environment() if self._simulated is None else self._simulated.environment

    def _simulate(
        self,
        env: Mapping[str, Any],
        episode: h5py.Group,
        frames: int,
        T_world_base: Array | None,
        calibration: Calibration | None,
    ) -> None:
        """Take the simulator at its word: objects, base and table, where it is of a task that there is an environment of. Else say why not."""
        task = simulated_task(env, self.embodiment, episode)
        if isinstance(task, str):
            self.dropped[STATES] = task
            return
        try:
            first = task.restored(episode, frames, self._names[0], self.root)
        except CEIError as error:
            self.dropped[STATES] = f"as they are not of {task.environment.id} ({error})"
            return
        if T_world_base is None and (calibration is None or calibration.T_world_base is None):
            self.scene = scene_without_metadata(first.T_world_base, calibration)
        if not same_place(self.scene.T_world_base, first.T_world_base):
            at = ", ".join(f"{x:g}" for x in first.T_world_base[:3, 3])
            self.dropped[STATES] = f"as the simulator has the robot at {at} m, not where it is said to be"
            return
        self._simulated = task
        del self.dropped[STATES]
        if OBJECTS in observations(episode, self.root)[0]:
            self.dropped[OBJECTS] = f"as {STATES} say it"
        if not self.table_from:
            self.set_table(first.surface_z_m, str(task.environment.id))

    def _bind_actions(
        self, joint_map: JointMap | None, kwargs: Mapping[str, Any], names: list[str]
    ) -> BoundActions | None:
        width, body = self._layout.actions, self.embodiment
        said = ActionMap() if joint_map is None else action_map(joint_map, ActionMap())
        if said is None:
            return None
        if said == ActionMap():
            if width is None:
                raise CEIError(
                    f"{self.root} has no {ACTIONS}, so that nothing says what the gripper was told; a joint map (--joint_map) with action: null takes "
                    "the next frame's state for it."
                )
            said = action_entries(kwargs, body, width, str(self.root))
        if said.feature not in (None, ACTIONS) or width is None:
            raise CEIError(f"{self.root} has no {said.feature or ACTIONS!r} for actions; HDF5 has them in {ACTIONS!r}.")
        said = ActionMap(ACTIONS, said.kind, said.joints, said.ignore)
        return bind_actions(said, body, [str(i) for i in range(width)], joint_map, names)

    def __len__(self) -> int:
        return len(self._names)

    def frames(self, index: int) -> int:
        """Frames of an episode, without reading it."""
        with hdf5.opened(self.root) as file:
            return len(self._checked(file, index)[0][next(iter(self._layout.columns))])

    def read(self, index: int, *, clouds: bool = True, colours: bool = True) -> Demonstration:
        """One episode; see `Source.read`."""
        self.select([index])
        where = f"{self.root}, {self._names[index]}"
        cloud = None
        with hdf5.opened(self.root) as file:
            found, entries = self._checked(file, index)
            state = np.column_stack([hdf5.read(found[name], self.root) for name in self._layout.columns])
            objects, object_names = self._objects(self._episode(file, index), found, len(state), where)
            actions = None if entries is None else hdf5.read(entries, self.root)
            if clouds and self.has_clouds:
                cloud = check_cloud(hdf5.read(found[CLOUD], self.root), len(state), where)
        joints = self.joints(state, actions, index, self._bound, self._actions)
        return Demonstration(
            embodiment=self.embodiment.name,
            fps=self.fps,
            qpos=joints.qpos,
            action=joints.action,
            scene=self.scene,
            task=self._task_of(index),
            point_cloud_world=cloud,
            environment_state=objects,
            environment_state_names=object_names,
            index=index,
            figures=joints.figures,
        )

    def _objects(
        self, episode: h5py.Group, found: Mapping[str, h5py.Dataset], frames: int, where: str
    ) -> tuple[Array | None, tuple[str, ...]]:
        """What is known of objects, (frames, k), and its names: as the simulator stored it, else as it was observed."""
        if self._simulated is not None:
            restored = self._simulated.restored(episode, frames, where, self.root)
            if not same_place(self.scene.T_world_base, restored.T_world_base):
                raise CEIError(
                    f"{where}: the robot stands elsewhere than in {self._names[0]}; leave it out with --episodes."
                )
            return restored.environment_state, self._simulated.state_names
        if OBJECTS not in found:
            return None, ()
        objects = hdf5.read(found[OBJECTS], self.root).astype(np.float64)
        if objects.ndim != 2 or len(objects) != frames:
            raise CEIError(
                f"{where}: obs/{OBJECTS} has shape {objects.shape}; it should have {frames} rows of numbers."
            )
        return objects, tuple(numbered_names(OBJECTS, objects.shape[1]))

    def carry(self, index: int) -> Carried:
        """See `Source.carry`."""
        columns: dict[str, Array | pa.Array] = {}
        with hdf5.opened(self.root) as file:
            episode = self._episode(file, index)
            for name in self._carried_as:
                key, dtype = CARRIED[name]
                if key not in self.carried:
                    continue
                data = hdf5.dataset_at(episode, name, self.root)
                if data is None or data.shape not in ((n := self.frames(index),), (n, 1)):
                    raise CEIError(
                        f"{self.root}, {self._names[index]}: {name} should be one number for each of its frames; leave it out with "
                        f"--drop_features={key}."
                    )
                columns[key] = hdf5.read(data, self.root).reshape(-1).astype(dtype)
        return Carried(columns)

    def _task_of(self, index: int) -> str:
        with hdf5.opened(self.root) as file:
            said = hdf5.json_attribute(self._episode(file, index), "ep_meta").get("lang")
        return said if isinstance(said, str) else self._task

    def _episode(self, file: h5py.File, index: int) -> h5py.Group:
        episode = hdf5.group_at(data_of(file, self.root), self._names[index], self.root)
        assert episode is not None
        return episode

    def _checked(self, file: h5py.File, index: int) -> tuple[dict[str, h5py.Dataset], h5py.Dataset | None]:
        """An episode's observations and actions, all with a row a frame and as long as the first episode's.

        Raises:
            CEIError: naming what differs.
        """
        where, episode = f"{self.root}, {self._names[index]}", self._episode(file, index)
        found, elsewhere = observations(episode, self.root)
        rows: dict[str, int] = {}
        for name, size in self._layout.columns.items():
            if name not in found:
                raise CEIError(
                    f"{where} lacks obs/{name}, which {self._names[0]} has{why_not(elsewhere, name)}; leave it out with --episodes."
                )
            shape = found[name].shape
            if len(shape) != 2 or shape[1] != size:
                raise CEIError(
                    f"{where}: obs/{name} has shape {shape}; as in {self._names[0]} it should have {size} columns."
                )
            rows[f"obs/{name}"] = shape[0]
        entries = None
        if self._actions is not None:
            entries = hdf5.dataset_at(episode, ACTIONS, self.root)
            if (width := width_of(entries, self.root)) != self._layout.actions or entries is None:
                raise CEIError(
                    f"{where}: {ACTIONS} has {width or 'no'} entries; as in {self._names[0]} it should have {self._layout.actions}."
                )
            rows[ACTIONS] = entries.shape[0]
        if self.has_clouds and CLOUD not in found:
            raise CEIError(
                f"{where} lacks obs/{CLOUD}, which {self._names[0]} has{why_not(elsewhere, CLOUD)}; leave it out with --episodes."
            )
        if len(set(rows.values())) > 1:
            counts = ", ".join(f"{count} of {name}" for name, count in rows.items())
            raise CEIError(
                f"{where} has {counts}: as many rows should be of each, one a frame; leave it out with --episodes."
            )
        return found, entries
