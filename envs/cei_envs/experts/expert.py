"""What the scripted experts share: waypoints of what takes hold, varied as people vary."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, ClassVar

import mink
import numpy as np
from scipy.spatial.transform import Rotation

from cei_envs.experts.grip import Grip, grip_between_pads
from cei_envs.experts.plan import Waypoint, grip_pose, plan
from cei_envs.experts.variation import Variation
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment

_CLEAR_M = 0.003  # fingertips stay off the table: one that drags on it stops, while the other pushes the thing away


class Expert(ABC):
    """Demonstrates one task with one robot.

    Args:
        embodiment: the robot.
        T_world_base: (4, 4) pose of its base, which stands upright.
        seed: of the variation.
        variation: how much demonstrations differ; 1 as people's do, 0 not at all.
    """

    @abstractmethod
    def __init__(self, embodiment: Embodiment, T_world_base: Array, seed: int, variation: float = 1.0) -> None: ...

    @abstractmethod
    def plan(self, agent_pos: Array, environment_state: Array) -> Array:
        """(T, n) joint targets from the start of an episode, rad or m.

        Args:
            agent_pos: (n,) joint positions, rad or m.
            environment_state: (k,) as the task gives it.
        """

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """How it varies, as JSON types, for the dataset's metadata."""


class ScriptedExpert(Expert):
    """A script: waypoints of a grip, varied as people vary."""

    grip: Grip | None = None
    """What goes through them; None for the grip site of robosuite's grippers."""

    def __init__(self, embodiment: Embodiment, T_world_base: Array, seed: int, variation: float = 1.0) -> None:
        self.embodiment, self._T_base_world = embodiment, np.linalg.inv(T_world_base)
        self._rng = np.random.default_rng([seed, 1])
        self._amount, self.variation = variation, Variation.sample(self._rng, variation)

    def describe(self) -> dict[str, Any]:
        """The variation, for the dataset's metadata."""
        return asdict(self.variation)

    def plan(self, agent_pos: Array, environment_state: Array) -> Array:
        """See `Expert.plan`."""
        waypoints = self.waypoints(np.asarray(environment_state, float))
        start = np.asarray(agent_pos, float)
        return plan(self.embodiment, start, waypoints, self.variation.jitter_m, self._rng, self.grip)

    @abstractmethod
    def waypoints(self, state: Array) -> Sequence[Waypoint]:
        """The grip's way from a state (k,) of the task's objects."""

    def waypoint(self, position_world: Array, rotation: Rotation, closed: float, frames: int) -> Waypoint:
        """At this expert's own speed."""
        T = self._T_base_world
        return Waypoint(
            T[:3, :3] @ position_world + T[:3, 3],
            Rotation.from_matrix(T[:3, :3]) * rotation,
            closed,
            self.variation.frames(frames),
        )


class ReachesDown(ScriptedExpert, ABC):
    """A script that comes from above."""

    @abstractmethod
    def reaching_down(self, closing_yaw_rad: float) -> Rotation:
        """Orientation of the grip in the world: pointing down, the fingers closing along a heading; leaning as varied."""


class PadExpert(ReachesDown):
    """A script for any hand whose first pad opposes its others: its grip is between them, where what it takes hold of will be."""

    width_m: ClassVar[float]
    """Of what it takes hold of, across."""

    def __init__(self, embodiment: Embodiment, T_world_base: Array, seed: int, variation: float = 1.0) -> None:
        super().__init__(embodiment, T_world_base, seed, variation)
        self.grip = self.make_grip()

    def make_grip(self) -> Grip:
        """How its hand takes hold; by default between home and closed."""
        return grip_between_pads(self.embodiment, self.width_m)

    @property
    def lowest_m(self) -> float:
        """Least height of the grip above what a thing lies on, as it reaches straight down: its fingertips stay off that."""
        assert self.grip is not None
        return self.grip.tip_m + _CLEAR_M

    @property
    def home_heading_rad(self) -> float:
        """The heading in the world along which its fingers would close at home."""
        _, home_base = grip_pose(self.embodiment, self.embodiment.home, self.grip)
        x, y, _ = self._T_base_world[:3, :3].T @ home_base.as_matrix()[:, 1]
        return float(np.arctan2(y, x))

    def facing(self, approach_world: Array, closing_world: Array) -> Rotation:
        """Orientation of the grip in the world.

        Args:
            approach_world: (3,) where the palm looks.
            closing_world: (3,) from the first pad to the others; what of it is not across the approach counts.
        """
        z = np.asarray(approach_world, float) / np.linalg.norm(approach_world)
        y = closing_world - z * (z @ closing_world)
        y /= np.linalg.norm(y)
        return Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=1))

    def reaching_down(self, closing_yaw_rad: float) -> Rotation:
        """See `ReachesDown`; of a gripper's two ways the same one for like headings, so that demonstrations of a task are of one kind."""
        v = self.variation
        turn = closing_yaw_rad - self.home_heading_rad
        # From home by less than 150 degrees one way and 30 the other: no task asks for a heading at these ends.
        yaw = closing_yaw_rad - np.pi * np.floor((turn + np.pi / 6) / np.pi)
        along = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        return Rotation.from_euler("xyz", [*v.tilt_rad, v.yaw_rad]) * self.facing(np.array([0.0, 0.0, -1.0]), along)


class GripperExpert(ReachesDown):
    """A script for an arm with a parallel gripper of robosuite's, which reaches down from above."""

    def reaching_down(self, closing_yaw_rad: float) -> Rotation:
        """See `ReachesDown`."""
        v = self.variation
        _, home = grip_pose(self.embodiment, self.embodiment.home)
        down = upright(home)
        x, y, _ = (down * home.inv()).apply(closing_direction_base(self.embodiment))
        # Fingers close from both sides, so half turns are alike: take the nearer one.
        turn = (closing_yaw_rad - np.arctan2(y, x) + np.pi / 2) % np.pi - np.pi / 2
        return Rotation.from_euler("xyz", [*v.tilt_rad, turn + v.yaw_rad]) * down


def upright(rotation: Rotation) -> Rotation:
    """The nearest rotation whose z axis points straight down and whose x axis heads along a world axis."""
    heading = np.round(np.arctan2(*rotation.as_matrix()[1::-1, 0]) / (np.pi / 2)) * np.pi / 2
    return Rotation.from_euler("ZX", [heading, np.pi])


def closing_direction_base(embodiment: Embodiment) -> Array:
    """(3,) unit direction in which the first pad moves when the hand closes at home, in the base frame."""
    closed = np.concatenate([embodiment.home[: embodiment.n_arm], embodiment.closed[embodiment.n_arm :]])
    assert embodiment.end_effector is not None
    body = embodiment.body_names[embodiment.body_id(embodiment.end_effector.pads[0].body)]
    there, here = (
        mink.Configuration(embodiment.model, q).get_transform_frame_to_world(body, "body").translation()
        for q in (closed, embodiment.home)
    )
    return (there - here) / np.linalg.norm(there - here)
