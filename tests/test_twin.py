"""The twin of a recording: what is held is found again, the robot is the robot, and answers follow what motions do."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from third_party import needs_robots

from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.rollout import record_episode
from cei_gym.alignment import ContactOptions
from cei_gym.demonstration import Camera
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.transfer.source_side import SourceSide
from cei_gym.twin import Evidence, Twin, TwinOptions
from cei_gym.twin.complete import complete
from cei_gym.twin.fit import fit_primitive
from cei_gym.twin.hold import Hold
from cei_gym.twin.robot import PREFIX, RobotPart
from cei_gym.twin.scene import build_scene
from cei_gym.twin.seen import FreeSpace, Seen
from cei_gym.twin.shape import Piece, Shape

SOURCE = "Panda-PandaGripper"
BOX = Shape("box", (Piece("box", (0.02, 0.02, 0.02), np.array([0.5, 0.0, 0.02])),))


def hold_of(width_m: float, height_m: float) -> Hold:
    """A hold at the origin that closes along y and lifts by 10 cm."""
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, 2, 3] = 0.1
    middle = np.array([[0, 0, height_m], [0, 0, height_m + 0.1]])
    contacts = np.array([[0, -width_m / 2, height_m], [0, width_m / 2, height_m]])
    return Hold(0, 1, T, middle, contacts, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.1]))


def nothing(points: np.ndarray) -> np.ndarray:
    return np.zeros(len(points), bool)


def test_a_pixel_that_sees_past_a_point_sees_that_it_is_not_there() -> None:
    T = np.diag([1.0, -1.0, -1.0, 1.0])  # looks straight down
    T[2, 3] = 1.0
    camera = Camera("front", 21, 21, np.array([[20.0, 0, 10], [0, 20.0, 10], [0, 0, 1]]), T)
    free = FreeSpace(((camera, np.full((21, 21), 0.8)),))  # a surface 20 cm high
    points = np.array([[0, 0, 0.5], [0, 0, 0.205], [0, 0, 0.1], [5.0, 0, 0.5], [0, 0, 2.0]])
    assert free.contains(points).tolist() == [True, False, False, False, False]


@pytest.mark.parametrize("kind", ["sphere", "box"])
def test_primitives_are_found_again(kind: str) -> None:
    rng = np.random.default_rng(0)
    if kind == "sphere":
        u = rng.normal(size=(600, 3))
        points = 0.022 * u / np.linalg.norm(u, axis=1, keepdims=True) + [0, 0, 0.022]
    else:
        points = rng.uniform(-1, 1, (600, 3))
        points /= np.abs(points).max(axis=1, keepdims=True)
        points = points * [0.03, 0.02, 0.025] + [0, 0, 0.025]
    points = points[points[:, 2] > 0.012] + rng.normal(0, 0.0005, (np.sum(points[:, 2] > 0.012), 3))
    hold = hold_of(2 * (0.022 if kind == "sphere" else 0.02), 0.02)
    seen = Seen(points, 0.0, FreeSpace(()))
    shape = fit_primitive(seen, complete(seen, hold, nothing), hold)
    assert shape is not None and shape.name == kind
    wanted = (0.022,) if kind == "sphere" else (0.02, 0.03, 0.025)  # along the closing axis first
    assert np.allclose(shape.pieces[0].size_m, wanted, atol=0.002)


def test_contacts_go_where_things_lay_before_they_were_pushed() -> None:
    rng = np.random.default_rng(1)
    lay = rng.uniform(-1, 1, (300, 3)) * [0.02, 0.012, 0.01] + [0, 0.01, 0.02]
    middle = hold_of(0.03, 0.02).where_seen(lay).contacts_world
    assert np.allclose(middle.mean(axis=0), [0, 0.01, 0.02], atol=0.002)


@pytest.mark.parametrize(
    "name",
    [SOURCE, "UR5e-FourierRight", "Panda-RobotiqThreeFinger", pytest.param("UR5e-AG95", marks=needs_robots)],
)
def test_links_are_where_the_tree_has_them_and_hands_keep_their_servos(
    name: str, request: pytest.FixtureRequest
) -> None:
    if name == "UR5e-AG95":
        request.getfixturevalue("third_party_robots")
    embodiment = load_embodiment(name)
    base = np.eye(4)
    base[:3, 3] = [0.1, -0.2, 0.3]
    model = build_scene(RobotPart.of(embodiment), base, 0.0, BOX, TwinOptions())
    data = mujoco.MjData(model)
    for q, value in enumerate(embodiment.closed):
        data.qpos[model.joint(f"{PREFIX}{q}").qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    links = base @ KinematicTree(embodiment).forward(embodiment.closed)
    for body in range(1, embodiment.model.nbody):
        assert np.allclose(data.body(f"{PREFIX}{body}").xpos, links[body, :3, 3], atol=1e-6)
    if name == "UR5e-FourierRight":
        assert model.actuator(f"{PREFIX}{embodiment.n_arm}").gainprm[0] == 4.0  # its description's, of the thumb's yaw
    assert model.body("object").mass == pytest.approx(400 * 0.04**3)


def test_what_follows_in_a_hand_follows_as_its_description_says() -> None:
    """The three-finger Robotiq's last links go on to close when its first are stopped, by tendons that yield."""
    embodiment = load_embodiment("Panda-RobotiqThreeFinger")
    model = build_scene(RobotPart.of(embodiment), np.eye(4), 0.0, BOX, TwinOptions())
    assert (model.ntendon, model.neq) == (embodiment.model.ntendon, embodiment.model.neq)
    for name in (f"{PREFIX}{q}" for q in range(embodiment.n_arm, len(embodiment.joint_names))):
        at, q = model.joint(name).id, int(name.removeprefix(PREFIX))
        if embodiment.model.jnt_limited[q]:
            assert np.allclose(model.jnt_range[at], embodiment.model.jnt_range[q])
    first = next(a for a in range(embodiment.model.nu) if embodiment.model.actuator(a).name == "ee/finger_1")
    driven = model.actuator(f"{PREFIX}{embodiment.model.actuator_trnid[first, 0]}")
    assert np.allclose(driven.ctrlrange, embodiment.model.actuator_ctrlrange[first])
    lengths = [mujoco.MjData(each) for each in (model, embodiment.model)]
    for each, data in zip((model, embodiment.model), lengths, strict=True):
        data.qpos[: embodiment.model.nq] = embodiment.closed
        mujoco.mj_forward(each, data)
    assert np.allclose(np.sort(lengths[0].ten_length), np.sort(lengths[1].ten_length), atol=1e-9)


def test_votes_that_disagree_are_unsure() -> None:
    assert [Evidence.of(v, ["box"], 0.7).answer for v in ([True] * 4, [False] * 4, [True, False])] == [
        *("holds", "fails", "unsure")
    ]
    assert TwinOptions().sure == 1.0  # a wrong answer is worse than none
    assert [Evidence.lost(v, 6, 1.0) for v in ([True] * 5, [True, False])] == [False, True]
    assert [Evidence.lost([True, False], 6, sure) for sure in (0.8, 0.9)] == [False, True]


def test_options_are_checked() -> None:
    for wrong in (
        {"density_kg_m3": 0},
        {"tries": 0},
        {"sure": 0.5},
        {"shift_m": -1},
        {"friction": 0},
        {"friction": np.inf},
        {"shift_m": np.nan},
    ):
        with pytest.raises(CEIError, match=next(iter(wrong))):
            TwinOptions(**wrong)


def seen_cube(state: np.ndarray) -> np.ndarray:
    """(N, 3) points on a cube's top and sides, by its state."""
    u = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3), axis=-1).reshape(-1, 3)
    u = u[(np.abs(u).max(axis=1) > 0.99) & (u[:, 2] > -0.6)]
    return Rotation.from_quat(state[3:7], scalar_first=True).apply(u * state[7:10]) + state[:3]


def test_a_twin_says_what_holds_what_fails_and_what_it_cannot_say() -> None:
    env = open_environment(f"CEI-PickCube-{SOURCE}")
    demonstration, info, _ = record_episode(env, 3, 3, variation=0.0)
    env.close()
    assert info["is_success"] and demonstration.environment_state is not None
    robot = load_embodiment(SOURCE)
    side = SourceSide(sample_representation(robot), ContactOptions(), None)
    grip = side.motion(demonstration, robot.coupled.reduce(robot.home)).grip
    assert grip is not None
    twin, frames = Twin(robot, robot), np.arange(len(demonstration))
    scenes = [seen_cube(state) for state in demonstration.environment_state]
    assert twin.judge(demonstration, scenes, grip, demonstration, frames).answer == "holds"

    opened = demonstration.action.copy()
    opened[:, robot.n_arm :] = demonstration.qpos[0, robot.n_arm :]
    never = replace(demonstration, action=opened)
    lets_go = twin.judge(demonstration, scenes, grip, never, frames)
    assert lets_go.answer == "fails" and not any(lets_go.votes)

    assert twin.judge(demonstration, [], grip, demonstration, frames).reason == "there are no clouds"
    still = replace(grip, held=np.zeros_like(grip.held))
    assert twin.judge(demonstration, scenes, still, demonstration, frames).reason == "the source carries nothing"
    # where the source itself cannot have held it, nothing is said of the target
    assert "source's own" in twin.judge(never, scenes, grip, demonstration, frames).record()["reason"]
