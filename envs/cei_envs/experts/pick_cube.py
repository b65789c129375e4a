"""A scripted expert for PickCube with a parallel gripper, varied as people vary."""

from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.plan import Waypoint, grip_pose, plan
from cei_gym.embodiment import Embodiment


@dataclass(frozen=True)
class Variation:
    """How one demonstration differs from the ideal one.

    Attributes:
        offset_m: (3,) error of the grasp point; up to 6 mm each way.
        yaw_rad: turn of the grasp about the vertical, up to 0.12.
        tilt_rad: (2,) lean of the approach about world x and y, up to 0.12.
        speed: 0.7 to 1.4.
        jitter_m: tremor of the hand.
    """

    offset_m: tuple[float, float, float]
    yaw_rad: float
    tilt_rad: tuple[float, float]
    speed: float
    jitter_m: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> "Variation":
        """Draw a variation."""
        x, y, z = rng.uniform(-0.006, 0.006, 3)
        tilt = rng.uniform(-0.12, 0.12, 2)
        return cls(
            (float(x), float(y), float(z)),
            float(rng.uniform(-0.12, 0.12)),
            (float(tilt[0]), float(tilt[1])),
            float(rng.uniform(0.7, 1.4)),
            float(rng.uniform(0.0005, 0.0015)),
        )


_ABOVE_M = 0.10
_LIFT_M = 0.15


class PickCubeExpert:
    """Reach over the cube, descend, close, lift.

    Args:
        embodiment: an arm with a parallel gripper.
        T_world_base: (4, 4) pose of its base.
        seed: of the variation.
    """

    def __init__(self, embodiment: Embodiment, T_world_base: np.ndarray, seed: int) -> None:
        self._embodiment, self._T_world_base = embodiment, T_world_base
        self._rng = np.random.default_rng([seed, 1])
        self.variation = Variation.sample(self._rng)

    def describe(self) -> dict:
        """The variation, for the dataset's metadata."""
        return asdict(self.variation)

    def plan(self, agent_pos: np.ndarray, environment_state: np.ndarray) -> np.ndarray:
        """(T, n) joint targets from the start of an episode.

        Args:
            agent_pos: (n,) joint positions, rad or m.
            environment_state: (11,) as PickCube gives it.
        """
        v, start = self.variation, np.asarray(agent_pos, float)
        to_base = np.linalg.inv(self._T_world_base)
        cube = to_base[:3, :3] @ environment_state[:3] + to_base[:3, 3]
        cube_rotation = Rotation.from_matrix(to_base[:3, :3]) * Rotation.from_quat(
            environment_state[3:7], scalar_first=True
        )
        _, down = grip_pose(self._embodiment, self._embodiment.home)
        # A cube looks the same every quarter turn: take the one nearest to the hand's own heading.
        turn = (cube_rotation.as_euler("ZYX")[0] + np.pi / 4) % (np.pi / 2) - np.pi / 4
        lean = Rotation.from_euler("xyz", [v.tilt_rad[0], v.tilt_rad[1], turn + v.yaw_rad])
        rotation = lean * _upright(down)
        grasp = cube + v.offset_m
        above, lift = grasp + [0, 0, _ABOVE_M], grasp + [0, 0, _LIFT_M]
        frames = [max(4, round(n / v.speed)) for n in (26, 14, 10, 20)]
        waypoints = [
            Waypoint(above, rotation, 0.0, frames[0]),
            Waypoint(grasp, rotation, 0.0, frames[1]),
            Waypoint(grasp, rotation, 1.0, frames[2]),
            Waypoint(lift, rotation, 1.0, frames[3]),
        ]
        return plan(self._embodiment, start, waypoints, v.jitter_m, self._rng)


def _upright(rotation: Rotation) -> Rotation:
    """The nearest rotation whose z axis points straight down and whose x axis heads along a world axis."""
    heading = np.round(np.arctan2(*rotation.as_matrix()[1::-1, 0]) / (np.pi / 2)) * np.pi / 2
    return Rotation.from_euler("ZX", [heading, np.pi])
