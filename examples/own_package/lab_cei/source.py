"""A format of one's own: `cei-convert --dataset.root=FOLDER`, where the folder has `robot.txt` and an `episode_*.csv` each, joints in rad or m."""

from pathlib import Path
from typing import Any

import numpy as np

from cei_converters.sources.scene import scene_without_metadata
from cei_converters.sources.source import Source
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError

ROBOT, FPS = "robot.txt", 20.0


class CsvSource(Source):
    """A folder with a CSV file an episode: a row a frame, a column a joint of the robot that `robot.txt` names."""

    def __init__(
        self, repo_id: str, root: str | Path, *, embodiment: str | None, joint_map: Any, T_world_base, calibration
    ) -> None:
        if joint_map is not None:
            raise CEIError(f"{root} says itself which columns are which joints; leave --joint_map out.")
        self.repo_id, self.root, self.fps = repo_id, Path(root), FPS
        self.embodiment = load_embodiment(embodiment or (self.root / ROBOT).read_text().strip())
        self.scene = scene_without_metadata(T_world_base, calibration)
        self.carried, self.dropped = {}, {}
        self._files = sorted(self.root.glob("episode_*.csv"))

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """A folder with the robot's name and an episode."""
        return (path / ROBOT).is_file() and (path / "episode_0.csv").is_file()

    def __len__(self) -> int:
        return len(self._files)

    def frames(self, index: int) -> int:
        """Frames of an episode."""
        return len(self._rows(index))

    def read(self, index: int, *, clouds: bool = True, colours: bool = True) -> Demonstration:
        """One episode; actions are the next frame's joints."""
        self.select([index])
        joints = self.joints(self._rows(index), None, index, None, None)
        return Demonstration(self.embodiment.name, self.fps, joints.qpos, joints.action, self.scene, index=index)

    def _rows(self, index: int) -> np.ndarray:
        try:
            rows = np.loadtxt(self._files[index], delimiter=",", ndmin=2)
        except ValueError as error:
            raise CEIError(f"{self._files[index]} is no table of numbers: {error}") from error
        if rows.shape[1] != (n := len(self.embodiment.joint_names)):
            raise CEIError(f"{self._files[index]} has {rows.shape[1]} columns; {self.embodiment.name} has {n} joints.")
        return rows
