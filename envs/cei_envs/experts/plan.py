"""From gripper waypoints to joint targets: smooth timing, human-like jitter, inverse kinematics by mink."""

from collections.abc import Sequence
from dataclasses import dataclass

import mink
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError

_GRIP_SITE = "ee/grip_site"
_ITERATIONS = 8
_TOLERANCE_M = 0.004


@dataclass(frozen=True)
class Waypoint:
    """Where the grip site should be after some frames.

    Attributes:
        position_base: (3,) m, robot's base frame.
        rotation_base: orientation of the grip site in the base frame.
        closed: 0 open to 1 closed.
        frames: how many frames it takes to get there.
    """

    position_base: np.ndarray
    rotation_base: Rotation
    closed: float
    frames: int


def grip_pose(embodiment: Embodiment, qpos: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """Pose of the grip site in the base frame at qpos (n,)."""
    pose = mink.Configuration(embodiment.model, qpos).get_transform_frame_to_world(_GRIP_SITE, "site")
    return pose.translation(), Rotation.from_matrix(pose.rotation().as_matrix())


def plan(
    embodiment: Embodiment,
    start: np.ndarray,
    waypoints: Sequence[Waypoint],
    jitter_m: float,
    rng: np.random.Generator,
) -> np.ndarray:
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
    targets = _inverse_kinematics(embodiment, start, positions, rotations)
    hand = slice(embodiment.n_arm, None)
    share = np.concatenate(closed)[:, None]
    targets[:, hand] = (1 - share) * embodiment.home[hand] + share * embodiment.closed[hand]
    return targets


def _inverse_kinematics(embodiment: Embodiment, start, positions, rotations) -> np.ndarray:
    configuration = mink.Configuration(embodiment.model, start)
    grip = mink.FrameTask(_GRIP_SITE, "site", position_cost=1.0, orientation_cost=0.5, lm_damping=1e-3)
    posture = mink.PostureTask(embodiment.model, cost=1e-3)
    posture.set_target(start)
    qpos = []
    for position, rotation in zip(positions, rotations, strict=True):
        quat_wxyz = rotation.as_quat(scalar_first=True)
        grip.set_target(mink.SE3.from_rotation_and_translation(mink.SO3(quat_wxyz), position))
        for _ in range(_ITERATIONS):
            velocity = mink.solve_ik(configuration, [grip, posture], 0.5, solver="daqp", damping=1e-6)
            configuration.integrate_inplace(velocity, 0.5)
        error = np.linalg.norm(grip.compute_error(configuration)[:3])
        if error > _TOLERANCE_M:
            raise CEIError(
                f"{embodiment.name}: the expert's waypoint {position.round(3)} m is {error * 1e3:.0f} mm out of reach."
            )
        qpos.append(configuration.q.copy())
    return np.array(qpos)
