"""The robosuite environment of tasks whose objects are our own: a table with them on it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.objects import MujocoXMLObject
from robosuite.models.tasks import ManipulationTask

from cei_envs.tasks.cube import TABLE_Z_M
from cei_envs.tasks.placed import Placed
from cei_gym.embodiment.resources import locate

ASSETS = Path(__file__).parents[1] / "assets"
_DEPTH_M, _THICKNESS_M = 0.8, 0.05


class Tabletop(ManipulationEnv):
    """robosuite's robot before a table, and objects on it, whose places an environment sets.

    Args:
        objects: what is on it; what is not free is fixed to the world.
        width_m: of the table, along y.
        robot_arguments: robosuite's.
    """

    def __init__(self, objects: Sequence[Placed], width_m: float = 0.8, **robot_arguments: Any) -> None:
        self._described, self._width_m = objects, width_m
        super().__init__(**robot_arguments)

    def reward(self, action=None) -> float:
        """Always 0: the Gymnasium environment around it knows the task."""
        return 0.0

    def _load_model(self) -> None:
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](_DEPTH_M))
        arena = TableArena(table_full_size=(_DEPTH_M, self._width_m, _THICKNESS_M), table_offset=(0, 0, TABLE_Z_M))
        arena.set_origin([0, 0, 0])
        self.model = ManipulationTask(
            mujoco_arena=arena,
            mujoco_robots=[robot],
            mujoco_objects=[_described(each) for each in self._described],
        )


def _described(placed: Placed) -> MujocoXMLObject:
    joints: Any = "default" if placed.free else None  # robosuite's annotation knows no fixed object
    path = locate(placed.description or f"{placed.name}.xml", ASSETS).path
    made = MujocoXMLObject(str(path), name=placed.name, joints=joints, duplicate_collision_geoms=True)
    made.get_obj().set("pos", f"0 0 {TABLE_Z_M}")
    return made
