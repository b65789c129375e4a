"""From gripper waypoints to joint targets: smooth timing, human-like jitter, inverse kinematics by mink."""

from collections.abc import Sequence
from dataclasses import dataclass

import mink
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation, Slerp

from cei_envs.experts.grip import Grip, site_grip
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import OutOfReachError

_ITERATIONS = 8
TOLERANCE_M = 0.004
"""A grip that misses its pose by more is out of reach."""


@dataclass(frozen=True)
class Waypoint:
    """Where the grip should be after some frames.

    Attributes:
        position_base: (3,) m, robot's base frame.
        rotation_base: its orientation in the base frame.
        closed: 0 open to 1 closed.
        frames: how many frames it takes to get there.
    """

    position_base: Array
    rotation_base: Rotation
    closed: float
    frames: int


def grip_pose(embodiment: Embodiment, qpos: Array, grip: Grip | None = None) -> tuple[Array, Rotation]:
    """Pose of a grip, or of the grip site, in the base frame at qpos (n,)."""
    grip = grip or site_grip(embodiment)
    pose = mink.Configuration(embodiment.model, qpos).get_transform_frame_to_world(grip.frame, grip.kind)
    T = pose.as_matrix() @ grip.T_frame_grip
    return T[:3, 3], Rotation.from_matrix(T[:3, :3])


def plan(
    embodiment: Embodiment,
    start: Array,
    waypoints: Sequence[Waypoint],
    jitter_m: float,
    rng: np.random.Generator,
    grip: Grip | None = None,
) -> Array:
    """Joint targets that pass through the waypoints.

    Args:
        embodiment: the robot.
        start: (n,) joint positions now, rad or m.
        waypoints: reached one after another with cosine timing.
        jitter_m: standard deviation of a smooth tremor of the hand.
        rng: of the tremor.
        grip: what goes through them, opening and closing by and by; default: the grip site, at once.

    Returns:
        (T, n) absolute joint targets.

    Raises:
        OutOfReachError: a waypoint is.
    """
    moved = grip or site_grip(embodiment)
    position, rotation = grip_pose(embodiment, start, moved)
    positions, rotations, hands, hand = [], [], [], start[embodiment.n_arm :]
    for w in waypoints:
        s = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, w.frames + 1) / w.frames)
        positions.append(position + s[:, None] * (w.position_base - position))
        rotations.append(Slerp([0, 1], Rotation.concatenate([rotation, w.rotation_base]))(s))
        held = moved.joints(np.array(w.closed))
        hands.append(hand + (np.ones(w.frames) if grip is None else s)[:, None] * (held - hand))
        position, rotation, hand = w.position_base, w.rotation_base, held
    positions, rotations = np.concatenate(positions), Rotation.concatenate(rotations)
    tremor = gaussian_filter1d(rng.normal(0, 1, positions.shape), 4, axis=0)
    positions = positions + jitter_m * tremor / max(tremor.std(), 1e-9)
    targets = _follow(embodiment, start, positions, rotations, moved)
    targets[:, embodiment.n_arm :] = np.concatenate(hands)
    return targets


class InverseKinematics:
    """Joint positions that bring a grip to a pose.

    Args:
        embodiment: the robot.
        posture: (n,) joint positions to stay close to where the pose leaves a choice, rad or m.
        grip: what is brought there; default: the grip site.

    Raises:
        CEIError: the default is asked for, and the end-effector has no grip site.
    """

    def __init__(self, embodiment: Embodiment, posture: Array, grip: Grip | None = None) -> None:
        grip = grip or site_grip(embodiment)
        self._configuration = mink.Configuration(embodiment.model, posture)
        self._T_grip_frame = np.linalg.inv(grip.T_frame_grip)
        self._grip = mink.FrameTask(grip.frame, grip.kind, position_cost=1.0, orientation_cost=0.5, lm_damping=1e-3)
        self._posture = mink.PostureTask(embodiment.model, cost=1e-3)
        self._posture.set_target(posture)

    def solve(self, start: Array, position: Array, rotation: Rotation) -> tuple[Array, float, float]:
        """A few Newton steps from `start` (n,) towards a pose near the one there.

        Args:
            start: (n,) joint positions, rad or m.
            position: (3,) m, robot's base frame.
            rotation: orientation of the grip in the base frame.

        Returns:
            (n,) joint positions, and by how much they miss the pose, m and rad.
        """
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation.as_matrix(), position
        self._grip.set_target(mink.SE3.from_matrix(T @ self._T_grip_frame))
        self._configuration.update(start)
        for _ in range(_ITERATIONS):
            velocity = mink.solve_ik(self._configuration, [self._grip, self._posture], 0.5, solver="daqp", damping=1e-6)
            self._configuration.integrate_inplace(velocity, 0.5)
        error = self._grip.compute_error(self._configuration)
        return self._configuration.q.copy(), float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))


def _follow(embodiment: Embodiment, start, positions, rotations, grip: Grip) -> Array:
    solver, qpos = InverseKinematics(embodiment, start, grip), [start]
    for position, rotation in zip(positions, rotations, strict=True):
        found, miss_m, _ = solver.solve(qpos[-1], position, rotation)
        if miss_m > TOLERANCE_M:
            raise OutOfReachError(
                f"{embodiment.name}: the expert's waypoint {position.round(3)} m is {miss_m * 1e3:.0f} mm out of reach."
            )
        qpos.append(found)
    return np.array(qpos[1:])
