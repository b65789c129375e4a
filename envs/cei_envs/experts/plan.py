"""From gripper waypoints to joint targets: smooth timing, human-like jitter, inverse kinematics by mink."""

from collections.abc import Sequence
from dataclasses import dataclass

import mink
import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError

_GRIP_SITE = "ee/grip_site"
_ITERATIONS = 8
TOLERANCE_M = 0.004
"""A grip site that misses its pose by more is out of reach."""


@dataclass(frozen=True)
class Waypoint:
    """Where the grip site should be after some frames.

    Attributes:
        position_base: (3,) m, robot's base frame.
        rotation_base: orientation of the grip site in the base frame.
        closed: 0 open to 1 closed.
        frames: how many frames it takes to get there.
    """

    position_base: Array
    rotation_base: Rotation
    closed: float
    frames: int


def grip_pose(embodiment: Embodiment, qpos: Array) -> tuple[Array, Rotation]:
    """Pose of the grip site in the base frame at qpos (n,)."""
    pose = mink.Configuration(embodiment.model, qpos).get_transform_frame_to_world(_GRIP_SITE, "site")
    return pose.translation(), Rotation.from_matrix(pose.rotation().as_matrix())


def plan(
    embodiment: Embodiment,
    start: Array,
    waypoints: Sequence[Waypoint],
    jitter_m: float,
    rng: np.random.Generator,
) -> Array:
    """Joint targets that pass through the waypoints.

    Args:
        start: (n,) joint positions now, rad or m.
        waypoints: reached one after another with cosine timing.
        jitter_m: standard deviation of a smooth tremor of the hand.
        rng: of the tremor.

    Returns:
        (T, n) absolute joint targets.

    Raises:
        CEIError: a waypoint is out of reach.
    """
    position, rotation = grip_pose(embodiment, start)
    positions, rotations, closed = [], [], []
    for w in waypoints:
        s = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, w.frames + 1) / w.frames)
        positions.append(position + s[:, None] * (w.position_base - position))
        rotations.append(Slerp([0, 1], Rotation.concatenate([rotation, w.rotation_base]))(s))
        closed.append(np.full(w.frames, w.closed))
        position, rotation = w.position_base, w.rotation_base
    positions, rotations = np.concatenate(positions), Rotation.concatenate(rotations)
    tremor = gaussian_filter1d(rng.normal(0, 1, positions.shape), 4, axis=0)
    positions = positions + jitter_m * tremor / max(tremor.std(), 1e-9)
    targets = _follow(embodiment, start, positions, rotations)
    hand = slice(embodiment.n_arm, None)
    share = np.concatenate(closed)[:, None]
    targets[:, hand] = (1 - share) * embodiment.home[hand] + share * embodiment.closed[hand]
    return targets


class InverseKinematics:
    """Joint positions that bring the grip site to a pose.

    Args:
        embodiment: one with a grip site.
        posture: (n,) joint positions to stay close to where the pose leaves a choice, rad or m.

    Raises:
        CEIError: the end-effector has no grip site.
    """

    def __init__(self, embodiment: Embodiment, posture: Array) -> None:
        if mujoco.mj_name2id(embodiment.model, mujoco.mjtObj.mjOBJ_SITE, _GRIP_SITE) < 0:
            raise CEIError(
                f"{embodiment.name}: the end-effector's description has no site named 'grip_site', which is what moves."
            )
        self._configuration = mink.Configuration(embodiment.model, posture)
        self._grip = mink.FrameTask(_GRIP_SITE, "site", position_cost=1.0, orientation_cost=0.5, lm_damping=1e-3)
        self._posture = mink.PostureTask(embodiment.model, cost=1e-3)
        self._posture.set_target(posture)

    def solve(self, start: Array, position: Array, rotation: Rotation) -> tuple[Array, float, float]:
        """A few Newton steps from `start` (n,) towards a pose near the one there.

        Args:
            start: (n,) joint positions, rad or m.
            position: (3,) m, robot's base frame.
            rotation: orientation of the grip site in the base frame.

        Returns:
            (n,) joint positions, and by how much they miss the pose, m and rad.
        """
        quat_wxyz = rotation.as_quat(scalar_first=True)
        self._grip.set_target(mink.SE3.from_rotation_and_translation(mink.SO3(quat_wxyz), position))
        self._configuration.update(start)
        for _ in range(_ITERATIONS):
            velocity = mink.solve_ik(self._configuration, [self._grip, self._posture], 0.5, solver="daqp", damping=1e-6)
            self._configuration.integrate_inplace(velocity, 0.5)
        error = self._grip.compute_error(self._configuration)
        return self._configuration.q.copy(), float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))


def _follow(embodiment: Embodiment, start, positions, rotations) -> Array:
    solver, qpos = InverseKinematics(embodiment, start), [start]
    for position, rotation in zip(positions, rotations, strict=True):
        found, miss_m, _ = solver.solve(qpos[-1], position, rotation)
        if miss_m > TOLERANCE_M:
            raise CEIError(
                f"{embodiment.name}: the expert's waypoint {position.round(3)} m is {miss_m * 1e3:.0f} mm out of reach."
            )
        qpos.append(found)
    return np.array(qpos[1:])
