"""A correction bends a trajectory around its holds as its figures say, by MuJoCo's kinematics, and leaves it elsewhere."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from problems import problem_of
from scipy.spatial.transform import Rotation

from cei_gym.alignment import AlignmentProblem, Motion
from cei_gym.alignment.contact.correction import Correction, Holds, corrected, dwelling
from cei_gym.alignment.grip import Grip
from cei_gym.errors import CEIError

ROBOTS = ("UR5e-FourierRight", "Panda-PandaGripper")
DT_S, FRAMES, CLOSES, TAKES, LETS_GO = 0.05, 80, 24, 32, 55


def poses(problem: AlignmentProblem, u: np.ndarray) -> np.ndarray:
    """(T, 4, 4) of the end-effector's first link."""
    model = problem.embodiment.model
    data, out = mujoco.MjData(model), np.tile(np.eye(4), (len(u), 1, 1))
    for t, qpos in enumerate(problem.embodiment.coupled.expand(u)):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        root = problem.embodiment.end_effector_root
        out[t, :3, :3], out[t, :3, 3] = data.xmat[root].reshape(3, 3), data.xpos[root]
    return out


def motion_of(problem: AlignmentProblem) -> tuple[Motion, np.ndarray]:
    """The arm at rest, a hand that closes, holds, and opens; what is held is 10 cm in front of the first link."""
    embodiment = problem.embodiment
    u = np.tile(embodiment.coupled.reduce(embodiment.home), (FRAMES, 1))
    closed = embodiment.coupled.reduce(embodiment.closed)
    hand = embodiment.coupled.independent >= embodiment.n_arm
    t = np.arange(FRAMES)
    share = np.clip((t - CLOSES) / (TAKES - CLOSES), 0, 1) - np.clip((t - LETS_GO) / (TAKES - CLOSES), 0, 1)
    u[:, hand] += 0.4 * share[:, None] * (closed - u[0])[hand]
    root = poses(problem, u[:1])[0]
    axis, middle = root[:3, 0], root[:3, 3] + 0.1 * root[:3, 2]
    contacts = np.tile(middle + 0.02 * np.multiply.outer([-1, 1], axis), (FRAMES, 1, 1))
    held = (t >= TAKES) & (t <= LETS_GO)
    rotation = np.tile(np.eye(3), (FRAMES, 1, 1))
    grip = Grip(np.tile(axis, (FRAMES, 1)), contacts, np.zeros((FRAMES, 3)), rotation, held)
    points, normals = (np.tile(each, (FRAMES, 1, 1)) for each in problem.place(u[0]))
    return Motion(points, normals, u[0], dt_s=DT_S, grip=grip), u


def axes_of(motion: Motion, root: np.ndarray) -> np.ndarray:
    """(3, 3) across, closing, approach, in columns."""
    assert motion.grip is not None
    closing = motion.grip.axis[0]
    return np.stack([np.cross(closing, root[:3, 2]), closing, root[:3, 2]], axis=1)


@pytest.mark.parametrize("name", ROBOTS)
def test_none_changes_nothing(name: str) -> None:
    problem = problem_of(name)
    motion, u = motion_of(problem)
    np.testing.assert_allclose(corrected(problem, motion, u, Correction()), u, atol=1e-12)
    np.testing.assert_array_equal(dwelling(motion, FRAMES, Correction()), np.arange(FRAMES))


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize(("figure", "column"), [("across_m", 0), ("closing_m", 1), ("approach_m", 2)])
def test_a_hand_is_moved_along_the_grips_axes_while_it_holds_and_nowhere_else(
    name: str, figure: str, column: int
) -> None:
    problem = problem_of(name)
    motion, u = motion_of(problem)
    before, after = (poses(problem, each) for each in (u, corrected(problem, motion, u, Correction(**{figure: 0.008}))))
    by = after[:, :3, 3] - before[:, :3, 3]
    axes = axes_of(motion, before[0])
    expected = np.zeros(3)
    expected[column] = 0.008
    np.testing.assert_allclose(by[TAKES : LETS_GO + 1] @ axes, np.tile(expected, (LETS_GO + 1 - TAKES, 1)), atol=1e-4)
    np.testing.assert_allclose(after[:, :3, :3], before[:, :3, :3], atol=1e-3)
    far = np.r_[0 : TAKES - 10, LETS_GO + 9 : FRAMES]
    np.testing.assert_array_equal(by[far], 0)
    size = np.linalg.norm(by, axis=1)
    assert (np.diff(size[: TAKES + 1]) > -1e-5).all()
    assert (np.diff(size[LETS_GO:]) < 1e-5).all()


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize(
    ("figure", "column"), [("about_across_rad", 0), ("about_closing_rad", 1), ("about_approach_rad", 2)]
)
def test_a_hand_is_turned_about_the_middle_of_what_it_holds(name: str, figure: str, column: int) -> None:
    problem = problem_of(name)
    motion, u = motion_of(problem)
    assert motion.grip is not None
    before, after = (
        poses(problem, each)[TAKES] for each in (u, corrected(problem, motion, u, Correction(**{figure: 0.1})))
    )
    turned = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
    expected = 0.1 * axes_of(motion, before)[:, column]
    np.testing.assert_allclose(turned, expected, atol=1e-3)
    middle = motion.grip.contacts[TAKES].mean(axis=0)
    held_before, held_after = (T[:3, :3].T @ (middle - T[:3, 3]) for T in (before, after))
    np.testing.assert_allclose(held_after, held_before, atol=1e-4)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_hand_closes_later_and_lets_go_when_it_did(name: str) -> None:
    problem = problem_of(name)
    motion, u = motion_of(problem)
    hand = problem.embodiment.coupled.independent >= problem.embodiment.n_arm
    for later in (0.2, -0.2):
        out, by = corrected(problem, motion, u, Correction(later_s=later)), round(later / DT_S)
        np.testing.assert_allclose(out[CLOSES + by : TAKES + by, hand], u[CLOSES:TAKES, hand], atol=1e-9)
        np.testing.assert_allclose(out[LETS_GO:], u[LETS_GO:], atol=1e-9)
        np.testing.assert_array_equal(out[:, ~hand], u[:, ~hand])


@pytest.mark.parametrize("name", ROBOTS)
def test_a_hand_opens_wider_before_it_closes(name: str) -> None:
    problem = problem_of(name)
    motion, u = motion_of(problem)
    out = corrected(problem, motion, u, Correction(wider_m=0.004))
    normals = problem.place(u[CLOSES])[1]
    by = np.einsum("ni,ni->n", problem.place(out[CLOSES])[0] - problem.place(u[CLOSES])[0], normals)
    lower, upper = problem.embodiment.independent_limits
    hand = problem.embodiment.coupled.independent >= problem.embodiment.n_arm
    room = ((u[CLOSES] - lower > 0.05) & (upper - u[CLOSES] > 0.05))[hand].all()
    assert by.mean() < 0 or not room  # a hand that is open as far as it can opens no wider
    np.testing.assert_allclose(out[TAKES:], u[TAKES:], atol=1e-9)
    np.testing.assert_array_equal(out[: TAKES - 20], u[: TAKES - 20])


def test_all_wait_where_a_hold_begins() -> None:
    motion, _ = motion_of(problem_of(ROBOTS[1]))
    shown = dwelling(motion, FRAMES, Correction(dwell_s=0.2))
    np.testing.assert_array_equal(shown, [*range(TAKES), *[TAKES] * 4, *range(TAKES, FRAMES)])


def test_a_grip_that_lets_go_for_a_moment_has_not_let_go() -> None:
    motion, _ = motion_of(problem_of(ROBOTS[1]))
    assert motion.grip is not None
    held = motion.grip.held.copy()
    held[40:44] = False
    held[70:75] = True
    holds = Holds.of(replace(motion.grip, held=held), DT_S)
    np.testing.assert_array_equal(holds.first, [TAKES, 70])
    np.testing.assert_array_equal(holds.last, [LETS_GO, 74])


@pytest.mark.parametrize("name", ROBOTS)
def test_limits_and_speeds_are_kept_however_large_a_correction_is(name: str) -> None:
    problem = problem_of(name)
    motion, u = motion_of(problem)
    lower, upper = problem.embodiment.independent_limits
    fastest = problem.embodiment.independent_max_velocity * DT_S
    rng = np.random.default_rng(0)
    for _ in range(10):
        large = dict(zip(Correction.names()[:6], rng.normal(0, [0.2] * 3 + [1.0] * 3), strict=True))
        out = corrected(problem, motion, u, Correction(**large, later_s=0.3, wider_m=0.05))
        assert ((out >= lower - 1e-9) & (out <= upper + 1e-9)).all()
        allowed = np.maximum(fastest, np.abs(np.diff(u, axis=0)))
        assert (np.abs(np.diff(out, axis=0)) <= allowed + 1e-9).all()


def test_where_nothing_is_held_nothing_is_corrected() -> None:
    problem = problem_of(ROBOTS[0])
    motion, u = motion_of(problem)
    assert motion.grip is not None
    never = replace(motion, grip=replace(motion.grip, held=np.zeros(FRAMES, bool)))
    for each in (never, replace(motion, grip=None)):
        np.testing.assert_array_equal(corrected(problem, each, u, Correction(approach_m=0.01, later_s=0.1)), u)
        np.testing.assert_array_equal(dwelling(each, FRAMES, Correction(dwell_s=1.0)), np.arange(FRAMES))


def test_it_is_told_in_words() -> None:
    assert str(Correction()) == "none"
    told = str(Correction(approach_m=0.009, about_closing_rad=-0.05, squeeze=1.2, later_s=0.1))
    assert told == "approach 9 mm, about closing -2.9 deg, squeeze 1.2, later 0.1 s"


@pytest.mark.parametrize(
    ("wrong", "says"), [({"squeeze": -1}, "squeeze"), ({"asymmetry": 2}, "asymmetry"), ({"across_m": np.nan}, "finite")]
)
def test_what_cannot_be_is_refused(wrong: dict, says: str) -> None:
    with pytest.raises(CEIError, match=says):
        Correction(**wrong)
