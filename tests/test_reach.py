"""Why a target does not follow: each cause is made to happen, and is the one that is named, with its numbers."""

from dataclasses import replace

import numpy as np
import pytest
from problems import problem_of

from cei_gym.alignment import ContactOptions, Motion, SolverOptions
from cei_gym.alignment.contact.observed import source_grip
from cei_gym.alignment.contact.pads import opposing_sides
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.judge.reach import Reach
from cei_gym.embodiment.names import END_EFFECTOR_PREFIX

OPTIONS = SolverOptions()


def motion_of(name: str, frames: int = 4, wide: float = 1.0) -> Motion:
    """What an embodiment at rest does; `wide` opens its pads' distance by that factor."""
    problem = problem_of(name)
    embodiment, tree = problem.embodiment, problem.tree
    T = tree.forward(np.tile(embodiment.home, (frames, 1)))
    sides = opposing_sides(problem.representation, tree)
    root = next(i for i, body in enumerate(embodiment.body_names) if body.startswith(END_EFFECTOR_PREFIX))
    assert sides is not None
    grip = source_grip(problem.representation, sides, root, T, np.zeros(frames, bool))
    points, normals = problem.representation.place(T)
    along = (grip.contacts[:, 0] - grip.contacts[:, 1]) * (wide - 1) / 2
    points = points + np.where(sides == 0, 1, -1)[:, None] * along[:, None]
    contacts = grip.contacts + np.array([1, -1])[:, None] * along[:, None]
    return Motion(
        points, normals, embodiment.coupled.reduce(embodiment.home), dt_s=0.05, grip=replace(grip, contacts=contacts)
    )


def explained(target: str, motion: Motion, frame: int = -1):
    problem = problem_of(target)
    motion = replace(motion, u0=problem.embodiment.coupled.reduce(problem.embodiment.home))
    track = Follower(problem, OPTIONS, ContactOptions(opposition_weight=0)).follow(motion)
    return Reach(problem).explain(motion, track, range(len(track.u))[frame]), track


def moved(motion: Motion, by_m: np.ndarray) -> Motion:
    """`by_m` (T, 3) or (3,) farther."""
    by_m = np.broadcast_to(by_m, (len(motion.points_base), 3))
    assert motion.grip is not None
    grip = replace(motion.grip, contacts=motion.grip.contacts + by_m[:, None])
    return replace(motion, points_base=motion.points_base + by_m[:, None], grip=grip)


def test_a_source_that_is_too_far_away_is_out_of_reach() -> None:
    """The Panda's data sheet: it reaches 0.855 m, and its gripper's finger tips are about 0.2 m farther."""
    miss, _ = explained("Panda-PandaGripper", moved(motion_of("UR5e-PandaGripper"), np.array([1.5, 0, 0])))
    assert "m from the target's base, whose own reach" in miss.cause
    reach_m = float(miss.cause.rpartition("reach ")[2].split()[0])
    assert 0.95 < reach_m < 1.35
    assert "--target_pose" in miss.remedy
    assert miss.distance_m > 0.5


def test_a_hand_that_opens_too_little_is_told_from_an_arm_that_is_too_short() -> None:
    """A Panda's fingers open to 80 mm."""
    problem = problem_of("Panda-PandaGripper")
    open_mm = 1e3 * np.linalg.norm(np.diff(motion_of("Panda-PandaGripper").grip.contacts[0], axis=0))
    miss, _ = explained("Panda-PandaGripper", motion_of("Panda-PandaGripper", wide=2.0))
    said = f"the source's pads are {2 * open_mm:.0f} mm apart there, and the target's open to "
    assert miss.cause.startswith(said)
    assert 78 <= int(miss.cause.removeprefix(said).split()[0]) <= 80
    assert "--joint_map" in miss.remedy
    assert miss.pad.startswith("finger_joint")
    assert problem.embodiment.n_arm == 7


def test_a_target_that_is_too_slow_is_named_with_its_joint_and_speed() -> None:
    away = np.zeros((4, 3))
    away[-1] = [0.0, 0.25, 0.0]  # 5 m/s
    miss, _ = explained("Panda-PandaGripper", moved(motion_of("Panda-PandaGripper"), away))
    assert "already moves as fast as it can" in miss.cause
    joint, speed = miss.cause.split()[0], float(miss.cause.partition("(")[2].split()[0])
    body = problem_of("Panda-PandaGripper").embodiment
    assert speed == pytest.approx(body.max_velocity[body.joint_names.index(joint)], rel=1e-2)
    assert "--transfer.stretch" in miss.remedy


def test_a_joint_at_its_limit_is_named() -> None:
    """Turned about its own axis by most of a turn, step by step, the last joint meets its end."""
    from scipy.spatial.transform import Rotation

    name = "Panda-PandaGripper"
    problem, still = problem_of(name), motion_of(name, frames=60)
    body = problem.embodiment
    T_flange = problem.tree.forward(body.home)[body.body_id("link7")]
    turns = Rotation.from_rotvec(np.linspace(0, 3.0, 60)[:, None] * T_flange[:3, 2])
    centre = T_flange[:3, 3]
    assert still.grip is not None
    turned = replace(
        still,
        points_base=np.stack(
            [turn.apply(p - centre) + centre for turn, p in zip(turns, still.points_base, strict=True)]
        ),
        normals_base=np.stack([turn.apply(n) for turn, n in zip(turns, still.normals_base, strict=True)]),
        grip=None,
    )
    miss, track = explained(name, turned)
    assert miss.cause.startswith("at a limit: ")
    named = miss.cause.removeprefix("at a limit: ").split()[0]
    q = body.joint_names.index(named)
    at = body.coupled.expand(track.u[-1])[q]
    assert min(at - body.lower[q], body.upper[q] - at) < 1e-3
    assert "--target_pose" in miss.remedy
