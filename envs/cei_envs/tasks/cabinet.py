"""The robosuite environment of OpenDrawer: a table with a cabinet."""

from pathlib import Path
from typing import Any

from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.objects import MujocoXMLObject
from robosuite.models.tasks import ManipulationTask

_CABINET = Path(__file__).parents[1] / "assets/cabinet.xml"
_TABLE_SIZE_M = (0.8, 0.8, 0.05)
_TABLE_Z_M = 0.8


class OpenDrawer(ManipulationEnv):
    """robosuite's table and robot, and a cabinet fixed to the table's middle."""

    def reward(self, action=None) -> float:
        """Always 0: the Gymnasium environment around it knows the task."""
        return 0.0

    def _load_model(self) -> None:
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](_TABLE_SIZE_M[0]))
        arena = TableArena(table_full_size=_TABLE_SIZE_M, table_offset=(0, 0, _TABLE_Z_M))
        arena.set_origin([0, 0, 0])
        nothing: Any = None  # robosuite's default is a free joint; its annotation knows no other
        cabinet = MujocoXMLObject(str(_CABINET), name="cabinet", joints=nothing, duplicate_collision_geoms=True)
        cabinet.get_obj().set("pos", f"0 0 {_TABLE_Z_M}")
        self.model = ManipulationTask(mujoco_arena=arena, mujoco_robots=[robot], mujoco_objects=[cabinet])
