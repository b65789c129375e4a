"""A task of one's own, `CEI-TouchCube-<Arm>-<EndEffector>`: touch a cube, for half a second. And a script that does."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cei_envs.experts.expert import upright
from cei_envs.experts.pick_cube import PickCubeExpert
from cei_envs.experts.plan import Waypoint, grip_pose
from cei_envs.tasks.pick_cube import PickCubeEnv


class TouchCubeEnv(PickCubeEnv):
    """PickCube's scene; done while any part of the robot touches the cube, for ten control periods in a row."""

    task: ClassVar[str] = "TouchCube"
    task_text: ClassVar[str] = "Touch the cube."
    held_ticks: ClassVar[int] = 10

    def is_done(self) -> bool:
        """Whether the robot touches the cube now."""
        return self.simulation.touching(self.cube.geoms, self.simulation.robot_geoms)

    def failure_reason(self) -> str:
        """Why not yet."""
        return "never touched"


class TouchCubeExpert(PickCubeExpert):
    """Reach over the cube, descend with closed fingers, and press a little."""

    def waypoints(self, state: np.ndarray) -> Sequence[Waypoint]:
        _, home = grip_pose(self.embodiment, self.embodiment.home)
        above, on = state[:3] + [0, 0, 0.12], state[:3] + [0, 0, 0.018]
        return [self.waypoint(p, upright(home), 1.0, n) for p, n in ((above, 26), (on, 14), (on, 15))]
