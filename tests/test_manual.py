"""Binary manual specification: tool frames, apertures and the arm that follows."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cei_gym.alignment.manual import ManualAlignment, ManualTool
from cei_gym.embodiment import END_EFFECTORS, build_embodiment, load_arm, load_embodiment, load_end_effector
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree

SOURCE = "Panda-PandaGripper"
TARGETS = ["IIWA-Inspire", "UR5e-RobotiqThreeFinger", "Kinova3-FourierLeft"]
FIRST_GROUP = {
    "FourierRight": "R_thumb_distal_link",
    "Inspire": "r_thumb_distal",
    "FourierLeft": "L_thumb_distal_link",
    "RobotiqThreeFinger": "finger_middle_link_3",
    "PandaGripper": "finger_joint1_tip",
}
T_TARGET_SOURCE = np.eye(4)
T_TARGET_SOURCE[:3, :3] = Rotation.from_euler("z", 10, degrees=True).as_matrix()
T_TARGET_SOURCE[:3, 3] = 0.1, -0.05, 0.03


@cache
def alignment(source: str, target: str, half_turn: bool = False) -> ManualAlignment:
    return ManualAlignment(load_embodiment(source), load_embodiment(target), half_turn)


def close_while_moving(name: str, frames: int = 16) -> np.ndarray:
    """(T, n) a trajectory that starts at home, moves every arm joint by up to 0.2 rad, and closes the end-effector."""
    embodiment = load_embodiment(name)
    s = np.linspace(0, 1, frames)[:, None]
    qpos = (1 - s) * embodiment.home + s * embodiment.closed
    arm = slice(0, embodiment.n_arm)
    qpos[:, arm] += 0.2 * np.sin(s * np.pi / 2) * np.random.default_rng(0).uniform(-1, 1, embodiment.n_arm)
    return qpos


def groups(name: str, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centroids of the thumb's pad and of the others, base frame, from another sample than the tool's own."""
    embodiment = load_embodiment(name)
    representation = sample_representation(embodiment, 1024, seed=7)
    points, _ = representation.place(KinematicTree(embodiment).forward(qpos))
    first = representation.body == embodiment.body_id(FIRST_GROUP[embodiment.end_effector.name])
    return points[..., first, :].mean(-2), points[..., ~first, :].mean(-2)


def distance(T: np.ndarray, T_other: np.ndarray) -> tuple[float, float]:
    """Largest difference of poses (T, 4, 4): metres and degrees."""
    turn = Rotation.from_matrix(np.swapaxes(T[:, :3, :3], 1, 2) @ T_other[:, :3, :3])
    return np.linalg.norm(T[:, :3, 3] - T_other[:, :3, 3], axis=1).max(), np.degrees(turn.magnitude().max())


# -- tool frames and apertures -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_a_tool_frame_sits_between_the_opposing_pads(name: str) -> None:
    embodiment = load_embodiment(f"UR5e-{name}")
    tool = ManualTool(embodiment)
    for pose in (embodiment.home, embodiment.closed):
        first, second = groups(embodiment.name, pose)
        assert tool.aperture(pose) == pytest.approx(np.linalg.norm(second - first), abs=2e-3)
    first, second = groups(embodiment.name, embodiment.home)
    T = tool.pose(embodiment.home)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    np.testing.assert_allclose(T[:3, 3], (first + second) / 2, atol=2e-3)
    assert T[:3, 0] @ (second - first) > 0.999 * np.linalg.norm(second - first)
    flange = KinematicTree(embodiment).forward(embodiment.home)[embodiment.model.body("right_hand").id, :3, 3]
    approach = T[:3, 3] - flange
    # What of the way from the flange is not along x is along z.
    np.testing.assert_allclose(T[:3, :3].T @ approach, [approach @ T[:3, 0], 0, T[:3, 2] @ approach], atol=1e-9)
    assert T[:3, 2] @ approach > 0.05


def test_the_tool_frame_stays_on_the_flange_when_a_thumb_leaves_it() -> None:
    embodiment = load_embodiment("UR5e-FourierRight")
    tool = ManualTool(embodiment)
    np.testing.assert_allclose(tool.pose(embodiment.closed), tool.pose(embodiment.home), atol=1e-12)
    middle = np.mean(groups(embodiment.name, embodiment.closed), axis=0)
    assert np.linalg.norm(middle - tool.pose(embodiment.closed)[:3, 3]) > 5e-3


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_a_hand_closes_until_it_first_has_the_aperture(name: str) -> None:
    manual = alignment(SOURCE, f"UR5e-{name}")
    home, closed = manual.target.embodiment.home, manual.target.embodiment.closed
    steps = np.linspace(0, 1, 1001)
    possible = manual.target.aperture((1 - steps[:, None]) * home + steps[:, None] * closed)
    wanted = np.linspace(-0.05, 0.3, 71)
    shares = manual.closing(wanted)
    found = manual.target.aperture((1 - shares[:, None]) * home + shares[:, None] * closed)
    np.testing.assert_allclose(found, np.clip(wanted, possible.min(), possible[0]), atol=1e-4)
    for share, aperture in zip(shares, found, strict=True):
        assert (possible[steps < share] > aperture - 1e-4).all()


def test_a_thumb_that_is_passed_has_an_aperture_twice() -> None:
    """Inspire's fingers pass its thumb at three quarters; what follows is not used."""
    manual = alignment(SOURCE, "UR5e-Inspire")
    home, closed = manual.target.embodiment.home, manual.target.embodiment.closed
    passed = manual.target.aperture(closed)
    share = manual.closing(np.array([passed]))[0]
    assert share < 0.8
    assert manual.target.aperture((1 - share) * home + share * closed) == pytest.approx(passed, abs=1e-4)


# -- trajectories --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [SOURCE, "UR5e-RobotiqThreeFinger", "UR5e-FourierLeft"])
def test_onto_itself_a_trajectory_stays_what_it_is(name: str) -> None:
    manual, qpos = alignment(name, name), close_while_moving(name)
    embodiment = load_embodiment(name)
    shares = np.linspace(0, 1, len(qpos))
    usable = shares <= manual.closing(manual.source.aperture(embodiment.closed[None]))[0]  # until a thumb is passed
    qpos = qpos[usable]
    found = embodiment.coupled.expand(manual.track(qpos, np.eye(4)))
    position_m, angle_deg = distance(manual.source.pose(qpos), manual.target.pose(found))
    assert position_m < 1e-5
    assert angle_deg < 1e-3
    np.testing.assert_allclose(manual.target.aperture(found), manual.source.aperture(qpos), atol=1e-5)
    hand = slice(0 if embodiment.n_arm == 6 else embodiment.n_arm, None)  # seven joints may do it in another way
    np.testing.assert_allclose(found[:, hand], qpos[:, hand], atol=2e-4)


@pytest.mark.parametrize("half_turn", [False, True])
@pytest.mark.parametrize("name", TARGETS)
def test_the_tool_frame_and_the_aperture_follow_the_source(name: str, half_turn: bool) -> None:
    manual, embodiment = alignment(SOURCE, name, half_turn), load_embodiment(name)
    qpos = close_while_moving(SOURCE)
    u = manual.track(qpos, T_TARGET_SOURCE)
    lower, upper = embodiment.independent_limits
    assert ((u >= lower) & (u <= upper)).all()
    found = embodiment.coupled.expand(u)
    position_m, angle_deg = distance(T_TARGET_SOURCE @ manual.source.pose(qpos), manual.target.pose(found))
    assert position_m < 1e-3
    assert angle_deg < 0.5
    wanted = manual.source.aperture(qpos)
    clipped = np.clip(wanted, manual.target.aperture(found).min(), manual.target.aperture(embodiment.home))
    np.testing.assert_allclose(manual.target.aperture(found), clipped, atol=1e-4)
    assert clipped[0] == wanted[0]
    hand = embodiment.coupled.independent >= embodiment.n_arm
    way = embodiment.coupled.reduce(embodiment.closed - embodiment.home)[hand]
    progress = (u - embodiment.coupled.reduce(embodiment.home))[:, hand] @ way / (way @ way)
    np.testing.assert_allclose(u[:, hand], embodiment.coupled.reduce(embodiment.home)[hand] + progress[:, None] * way)
    assert (np.diff(progress) >= 0).all()
    assert progress[-1] > progress[0] + 0.2
    assert np.abs(np.diff(u[:, ~hand], axis=0)).max() < 0.2  # no jump from one arm pose to another


@pytest.mark.parametrize("name", TARGETS)
def test_an_open_hands_pads_stand_around_the_same_point_on_the_same_line(name: str) -> None:
    """An oracle apart from tool frames: a hand as good as open has its pads' middle where the source's is."""
    source, target = load_embodiment(SOURCE), load_embodiment(name)
    qpos = source.home[None]
    ends = groups(SOURCE, qpos[0])
    for half_turn in (False, True):
        u = alignment(SOURCE, name, half_turn).track(qpos, np.eye(4))
        u[:, target.coupled.independent >= target.n_arm] = target.coupled.reduce(target.home)[
            target.coupled.independent >= target.n_arm
        ]
        thumb, fingers = groups(name, target.coupled.expand(u)[0])
        np.testing.assert_allclose((thumb + fingers) / 2, np.mean(ends, axis=0), atol=3e-3)
        line, line_source = (fingers - thumb), (ends[1] - ends[0])
        cosine = line @ line_source / np.linalg.norm(line) / np.linalg.norm(line_source)
        assert cosine * (-1 if half_turn else 1) > 0.999


@pytest.mark.parametrize(
    ("name", "yaw_deg", "within_m"),
    # Where a limit is cut off afterwards, 76 mm and 50 deg; from the home pose alone, 52 mm.
    [("IIWA-Inspire", 10, 0.045), ("Panda-RobotiqThreeFinger", 60, 0.025)],
)
def test_at_the_edge_of_reach_the_nearest_pose_is_found(name: str, yaw_deg: float, within_m: float) -> None:
    manual, qpos = alignment(SOURCE, name), close_while_moving(SOURCE, 5)
    T_target_source = np.eye(4)
    T_target_source[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    found = load_embodiment(name).coupled.expand(manual.track(qpos, T_target_source))
    position_m, angle_deg = distance(T_target_source @ manual.source.pose(qpos), manual.target.pose(found))
    assert position_m < within_m
    assert angle_deg < 3


def test_out_of_reach_a_trajectory_keeps_within_limits_and_points_there() -> None:
    manual, embodiment = alignment(SOURCE, "IIWA-Inspire"), load_embodiment("IIWA-Inspire")
    T_target_source = np.eye(4)
    T_target_source[0, 3] = 1.5
    qpos = close_while_moving(SOURCE, 3)
    u = manual.track(qpos, T_target_source)
    lower, upper = embodiment.independent_limits
    assert ((u >= lower) & (u <= upper)).all()
    wanted = (T_target_source @ manual.source.pose(qpos))[:, 0, 3]
    found = manual.target.pose(embodiment.coupled.expand(u))[:, 0, 3]
    assert (found < wanted - 0.2).all()
    assert (found > manual.target.pose(embodiment.home)[0, 3] + 0.1).all()


# -- bad input -----------------------------------------------------------------------------------------------


def test_a_target_needs_an_arm() -> None:
    with pytest.raises(CEIError, match="Inspire has no arm") as error:
        ManualAlignment(load_embodiment(SOURCE), build_embodiment(None, load_end_effector("Inspire")))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("bodies", [("r_index_distal",), ("r_index_distal", "r_middle_distal")])
def test_pads_must_oppose_each_other(bodies: tuple[str, ...]) -> None:
    hand = load_end_effector("Inspire")
    hand = replace(hand, pads=[pad for pad in hand.pads if pad.body in bodies])
    with pytest.raises(CEIError, match="no pads that oppose each other") as error:
        ManualTool(build_embodiment(load_arm("Panda"), hand))
    assert "Panda-Inspire" in str(error.value)
    assert "\n" not in str(error.value)
