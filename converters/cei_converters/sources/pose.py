"""End-effector poses in a dataset's columns, and the arm's joints that they stand for."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.errors import CEIError, unknown

FORMAT = """where a dataset has the end-effector's pose instead of the arm's joints, its joint map has
  pose:
    columns: {start: 0, end: 7}  # x, y, z, then the rotation
    rotation: quat_xyzw  # quat_wxyz, rotvec, euler_xyz (fixed axes), rot6d (two columns of the matrix)
    frame: base  # or world
    unit: m  # or mm; angles are rad
    link: ""  # whose pose it is; default: the arm's flange
    tool: {position: [0, 0, 0.1034], quaternion_wxyz: [1, 0, 0, 0]}  # of what is recorded in that link"""
_QUATERNIONS = {"quat_xyzw": False, "quat_wxyz": True}
_NUMBERS = {"quat_xyzw": 4, "quat_wxyz": 4, "rotvec": 3, "euler_xyz": 3, "rot6d": 6}
_FRAMES = ("base", "world")
_PER_M = {"m": 1.0, "mm": 1e-3}


@dataclass(frozen=True)
class Span:
    """Neighbouring columns, from `start` up to, but not with, `end`."""

    start: int
    end: int


@dataclass(frozen=True)
class Tool:
    """Pose of what is recorded, in its link's frame."""

    position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    quaternion_wxyz: list[float] = field(default_factory=lambda: [1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class PoseMap:
    """Where and how poses are stored; see `FORMAT`."""

    columns: Span | list[str]
    rotation: str
    frame: str = "base"
    unit: str = "m"
    link: str = ""
    tool: Tool = field(default_factory=Tool)

    def check(self, count: int, where: str) -> None:
        """Check the names in it, and that there are columns for all numbers.

        Raises:
            CEIError: saying what would be right.
        """
        for kind, name, valid in (
            ("rotation", self.rotation, _NUMBERS),
            ("frame", self.frame, _FRAMES),
            ("unit", self.unit, _PER_M),
        ):
            if name not in valid:
                raise CEIError(f"{where}: pose: {unknown(kind, name, valid)}")
        if count != 3 + _NUMBERS[self.rotation]:
            raise CEIError(f"{where}: pose: {self.rotation} needs {3 + _NUMBERS[self.rotation]} columns, not {count}.")
        sizes = len(self.tool.position), len(self.tool.quaternion_wxyz)
        numbers = [*self.tool.position, *self.tool.quaternion_wxyz]
        if (
            sizes != (3, 4)
            or not np.isfinite(numbers).all()
            or not np.isclose(np.linalg.norm(numbers[3:]), 1, atol=1e-2)
        ):
            raise CEIError(f"{where}: pose: tool needs a position (3, m) and a quaternion_wxyz of length 1.")

    def T_base_link(self, values: Array, T_world_base: Array, where: str) -> Array:
        """(T, k) columns to (T, 4, 4) poses of the link in the robot's base frame, m.

        Raises:
            CEIError: a rotation is none.
        """
        T = np.tile(np.eye(4), (len(values), 1, 1))
        T[:, :3, 3] = values[:, :3] * _PER_M[self.unit]
        T[:, :3, :3] = self._rotations(values[:, 3:], where)
        if self.frame == "world":
            T = np.linalg.inv(T_world_base) @ T
        T_link_tool = np.eye(4)
        T_link_tool[:3, 3] = self.tool.position
        T_link_tool[:3, :3] = Rotation.from_quat(self.tool.quaternion_wxyz, scalar_first=True).as_matrix()
        return T @ np.linalg.inv(T_link_tool)

    def _rotations(self, values: Array, where: str) -> Array:
        if self.rotation in _QUATERNIONS:
            length = np.linalg.norm(values, axis=1)
            if (bad := np.flatnonzero(~np.isclose(length, 1, atol=1e-2))).size:
                raise CEIError(f"{where}, frame {bad[0]}: the quaternion has length {length[bad[0]]:.4g}, not 1.")
            return Rotation.from_quat(values, scalar_first=_QUATERNIONS[self.rotation]).as_matrix()
        if self.rotation == "rotvec":
            return Rotation.from_rotvec(values).as_matrix()
        if self.rotation == "rot6d":  # Gram-Schmidt, as Zhou et al., 2019
            x = values[:, :3] / np.linalg.norm(values[:, :3], axis=1, keepdims=True)
            y = values[:, 3:] - np.sum(x * values[:, 3:], axis=1, keepdims=True) * x
            y /= np.linalg.norm(y, axis=1, keepdims=True)
            return np.stack([x, y, np.cross(x, y)], axis=2)
        return Rotation.from_euler("xyz", values).as_matrix()
