"""Transferring a demonstration: what comes out, what a squeeze changes, and the synthesised cloud."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cei_gym.alignment import ContactOptions, InitialisationOptions
from cei_gym.demonstration import Camera, Demonstration, Scene
from cei_gym.embodiment import Embodiment, load_embodiment
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import CloudOptions, SurfaceSampler
from cei_gym.rendering import look_at, unproject
from cei_gym.transfer import Transfer, TransferOptions

FRAMES = 12
SOURCE, TARGETS = "Panda-PandaGripper", ("UR5e-RobotiqThreeFinger", "IIWA-Inspire")
OPTIONS = TransferOptions(points=32)
CLOUDS = CloudOptions(robot_points=4096)
NO_SQUEEZE = ContactOptions(squeeze_m=0.0)
INIT = InitialisationOptions(starts=48, iterations=15, basins=3)
TABLE_Z = 0.0
T_WORLD_BASE = np.array([[0.0, -1, 0, 0.2], [1, 0, 0, -0.5], [0, 0, 1, 0.0], [0, 0, 0, 1]])


def demonstration(**changes) -> Demonstration:
    """A Panda that leans forward and closes on something 30 mm wide; its action asks for less."""
    body = load_embodiment(SOURCE)
    s = np.linspace(0, 1, FRAMES)[:, None]
    qpos = body.home + s * np.array([0.1, 0.15, 0, -0.1, 0, 0.1, 0, 0, 0])
    opening = np.maximum(0.04 - 0.06 * s, 0.015)
    qpos[:, 7:] = opening * [1, -1]
    action = np.concatenate([qpos[1:], qpos[-1:]])
    closing = opening[:, 0] == 0.015
    action[closing, 7:] = 0
    # Forward in the world is up to the base's turn: a box all around it.
    workspace = np.array([[-1.0, -1.0, TABLE_Z], [1.2, 1.2, 1.2]])
    scene = Scene(T_WORLD_BASE, (), workspace)
    return replace(Demonstration(SOURCE, 20.0, qpos, action, scene, task="Close.", index=7), **changes)


def source_surface(qpos: np.ndarray, n: int = 3000) -> np.ndarray:
    body = load_embodiment(SOURCE)
    sample = SurfaceSampler(visual_link_meshes(body.model), n, seed=9)
    return sample(T_WORLD_BASE @ KinematicTree(body).forward(qpos))


def table(n: int = 2000) -> np.ndarray:
    xy = np.random.default_rng(0).uniform(-0.9, 1.1, (n, 2))
    return np.column_stack([xy, np.full(n, TABLE_Z + 0.01)])


def surface_distance(embodiment: Embodiment, qpos: np.ndarray, T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(N,) m, by trimesh (good to 0.2 mm), from points in the world to the robot's visual surface."""
    poses = T @ KinematicTree(embodiment).forward(qpos)
    meshes = visual_link_meshes(embodiment.model)
    placed = [m.copy().apply_transform(X) for m, X in zip(meshes, poses, strict=True) if m is not None]
    return trimesh.proximity.closest_point(trimesh.util.concatenate(placed), points)[1]


def pad_gap(embodiment: Embodiment, qpos: np.ndarray) -> np.ndarray:
    """(T,) distance of the first pad's centre from that of the others."""
    representation = sample_representation(embodiment, 64)
    points, _ = representation.place(KinematicTree(embodiment).forward(qpos))
    pads = embodiment.end_effector.pads
    lead = representation.body == embodiment.body_id(max(pads, key=lambda pad: pad.share).body)
    return np.linalg.norm(points[:, lead].mean(1) - points[:, ~lead].mean(1), axis=-1)


@pytest.fixture(scope="module")
def transfer() -> Callable[..., Transfer]:
    """Transfers, each fitted once to the same demonstration."""
    fitted: dict = {}

    def make(target: str, **contact) -> Transfer:
        key = (target, *contact.items())
        if key not in fitted:
            bodies = load_embodiment(SOURCE), load_embodiment(target)
            fitted[key] = Transfer(*bodies, OPTIONS, clouds=CLOUDS, init=INIT, contact=ContactOptions(**contact))
            fitted[key].fit([demonstration()])
        return fitted[key]

    return make


# -- joints --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", TARGETS)
def test_a_transfer_is_a_demonstration_of_the_target(target: str, transfer: Callable) -> None:
    source, body = demonstration(), load_embodiment(target)
    moved, report = transfer(target)(source)
    n = len(body.joint_names)
    assert (moved.embodiment, moved.qpos.shape, moved.action.shape) == (target, (FRAMES, n), (FRAMES, n))
    kept = ("fps", "task", "index")
    assert [getattr(moved, key) for key in kept] == [getattr(source, key) for key in kept]
    assert (moved.point_cloud_world, moved.depth_m) == (None, {})
    np.testing.assert_array_equal(moved.scene.T_world_base, T_WORLD_BASE)
    for values in (moved.qpos, moved.action):
        assert (values >= body.lower - 1e-9).all()
        assert (values <= body.upper + 1e-9).all()
        np.testing.assert_allclose(body.coupled.expand(body.coupled.reduce(values)), values, atol=1e-12)
    assert report.unreachable_frames == []
    assert report.pad_distance_mm.max() < 15
    assert len(report.objective_m) == FRAMES


@pytest.mark.parametrize("target", TARGETS)
def test_pads_are_where_the_sources_were(target: str, transfer: Callable) -> None:
    """Without the report's own arithmetic: centres of all pads, in the world."""
    moved, _ = transfer(target)(demonstration())
    centres = []
    for name, qpos in ((SOURCE, demonstration().qpos), (target, moved.qpos)):
        body = load_embodiment(name)
        points, _ = sample_representation(body, 64).place(T_WORLD_BASE @ KinematicTree(body).forward(qpos))
        centres.append(points.mean(axis=1))
    apart = np.linalg.norm(centres[0] - centres[1], axis=-1)
    assert apart.max() < 0.03  # contact points agree (tests/test_grasp.py), so middles of large pads cannot
    travelled = np.linalg.norm(centres[0][-1] - centres[0][0])
    assert travelled > 0.05


@pytest.mark.parametrize("target", TARGETS)
def test_without_squeeze_actions_are_the_next_states(target: str, transfer: Callable) -> None:
    moved, _ = transfer(target, squeeze_m=0.0)(demonstration())
    np.testing.assert_array_equal(moved.action[:-1], moved.qpos[1:])
    np.testing.assert_array_equal(moved.action[-1], moved.qpos[-1])


@pytest.mark.parametrize("target", TARGETS)
def test_a_squeeze_closes_actions_and_leaves_states(target: str, transfer: Callable) -> None:
    plain, _ = transfer(target, squeeze_m=0.0)(demonstration())
    squeezed, _ = transfer(target)(demonstration())
    np.testing.assert_allclose(squeezed.qpos, plain.qpos, atol=1e-9)
    arm = slice(load_embodiment(target).n_arm)
    np.testing.assert_allclose(squeezed.action[:, arm], plain.action[:, arm], atol=1e-9)
    closer = pad_gap(load_embodiment(target), plain.action) - pad_gap(load_embodiment(target), squeezed.action)
    told = (demonstration().action[1:, 7] < demonstration().qpos[1:, 7] - 1e-9).nonzero()[0]
    assert len(told) > 3
    assert closer[told[2:]].min() > 0.004  # of 2 x 10 mm: pads turn as they close
    assert closer.max() < 0.03


@pytest.mark.parametrize(("asked_m", "expected_m"), [(0.012, 0.003), (0.0, 0.010), (0.030, 0.0)])
def test_a_squeeze_asks_for_no_more_than_the_source_did(asked_m: float, expected_m: float, transfer: Callable) -> None:
    """Pads are to move by what the command goes beyond the state, at most squeeze_m."""
    action = demonstration().action.copy()
    action[-1, 7:] = asked_m * np.array([1, -1])
    target = load_embodiment(TARGETS[0])
    moved, _ = transfer(TARGETS[0])(demonstration(action=action))
    representation, tree = sample_representation(target, OPTIONS.points, OPTIONS.seed), KinematicTree(target)
    (is_, normals), (told, _) = (representation.place(tree.forward(q[-1])) for q in (moved.qpos, moved.action))
    assert ((told - is_) * normals).sum(axis=1).mean() == pytest.approx(
        expected_m, rel=0.15, abs=1e-6
    )  # to first order


def test_the_same_transfer_twice_is_the_same(transfer: Callable) -> None:
    target = TARGETS[0]
    first, _ = transfer(target)(demonstration())
    again, _ = transfer(target)(demonstration())
    fresh = Transfer(load_embodiment(SOURCE), load_embodiment(target), OPTIONS, clouds=CLOUDS, init=INIT)
    afresh, _ = fresh(demonstration())  # fits itself to the first demonstration it sees
    for other in (again, afresh):
        np.testing.assert_array_equal(other.qpos, first.qpos)
        np.testing.assert_array_equal(other.action, first.action)


def test_one_basin_serves_all_demonstrations(transfer: Callable) -> None:
    target = TARGETS[0]
    lower = demonstration()
    lower = replace(lower, qpos=lower.qpos + np.array([0.05, 0.02, 0, 0, 0, 0, 0, 0, 0]))
    first, _ = transfer(target)(demonstration())
    second, _ = transfer(target)(lower)
    assert np.abs(first.qpos[0] - second.qpos[0]).max() < 0.5


def test_the_targets_base_may_stand_elsewhere() -> None:
    body, turn = load_embodiment(TARGETS[0]), np.eye(4)
    turn[:3, 3] = 0.1, -0.1, 0.05
    fitted = Transfer(
        load_embodiment(SOURCE), body, OPTIONS, clouds=CLOUDS, init=INIT, T_world_target=turn @ T_WORLD_BASE
    )
    moved, report = fitted(demonstration())
    np.testing.assert_allclose(moved.scene.T_world_base, turn @ T_WORLD_BASE)
    assert report.pad_distance_mm.max() < 15
    source = load_embodiment(SOURCE)
    points, _ = sample_representation(source, 64).place(
        T_WORLD_BASE @ KinematicTree(source).forward(demonstration().qpos)
    )
    found, _ = sample_representation(body, 64).place(moved.scene.T_world_base @ KinematicTree(body).forward(moved.qpos))
    assert np.linalg.norm(points.mean(1) - found.mean(1), axis=-1).max() < 0.03


def test_a_source_transferred_to_itself_stays_what_it_is() -> None:
    fitted = Transfer(
        load_embodiment(SOURCE), load_embodiment(SOURCE), OPTIONS, clouds=CLOUDS, init=INIT, contact=NO_SQUEEZE
    )
    moved, report = fitted(demonstration())
    assert report.pad_distance_mm.max() < 0.5
    np.testing.assert_allclose(moved.qpos[:, 7:], demonstration().qpos[:, 7:], atol=5e-4)


def test_another_embodiments_demonstration_is_refused(transfer: Callable) -> None:
    body = load_embodiment("IIWA-PandaGripper")
    qpos = np.tile(body.home, (3, 1))
    wrong = replace(demonstration(), embodiment=body.name, qpos=qpos, action=qpos)
    with pytest.raises(CEIError) as error:
        transfer(TARGETS[0])(wrong)
    assert str(error.value) == "episode 7 is of IIWA-PandaGripper, not of Panda-PandaGripper."


# -- cloud ---------------------------------------------------------------------------------------------------


def test_the_cloud_shows_the_target_and_no_more_of_the_source(transfer: Callable) -> None:
    target = TARGETS[0]
    source = demonstration()
    clouds = np.stack([np.concatenate([source_surface(q), table()]) for q in source.qpos]).astype(np.float32)
    moved, _ = transfer(target)(replace(source, point_cloud_world=clouds))
    cloud = moved.point_cloud_world
    assert cloud.shape == (FRAMES, 1024, 3)
    assert cloud.dtype == np.float32
    lower, upper = source.scene.workspace_world
    assert (cloud >= lower - 1e-6).all()
    assert (cloud <= upper + 1e-6).all()
    t = FRAMES - 1
    of_table = np.abs(cloud[t, :, 2] - TABLE_Z - 0.01) < 1e-6
    assert of_table.sum() > 200
    robot = cloud[t, ~of_table]
    assert len(robot) > 100
    some = robot[:: len(robot) // 100]
    assert surface_distance(load_embodiment(target), moved.qpos[t], T_WORLD_BASE, some).max() < 5e-4
    near = cloud[t, of_table]
    near = near[np.linalg.norm(near[:, :2] - T_WORLD_BASE[:2, 3], axis=1).argsort()[:50]]
    assert surface_distance(load_embodiment(SOURCE), source.qpos[t], T_WORLD_BASE, near).min() > 0.005 - 1e-5


def test_clouds_come_from_depth_where_there_is_depth(transfer: Callable) -> None:
    target, source = TARGETS[0], demonstration()
    camera = look_at("top", (0.2, 0.3, 2.0), (0.2, 0.31, 0.0), 64, 48, 45.0)
    assert isinstance(camera, Camera)
    depth = np.full((FRAMES, 48, 64), 1.5, np.float32)  # a wall at 0.5 m height, say
    depth[:, :10] = 0  # nothing known
    seen = unproject(depth[0], camera)
    assert len(seen) == 38 * 64
    scene = replace(source.scene, cameras=(camera,))
    moved, _ = transfer(target)(replace(source, scene=scene, depth_m={"top": depth}))
    assert moved.depth_m == {}
    assert moved.point_cloud_world.shape == (FRAMES, 1024, 3)
    to_wall = np.linalg.norm(moved.point_cloud_world[0][:, None] - seen[None], axis=-1).min(1)
    on_wall = to_wall < 1e-5
    assert on_wall.sum() > 200
    robot = moved.point_cloud_world[0][~on_wall]
    robot = robot[:: max(1, len(robot) // 100)]
    assert surface_distance(load_embodiment(target), moved.qpos[0], T_WORLD_BASE, robot).max() < 5e-4


def test_clouds_are_the_same_twice(transfer: Callable) -> None:
    source = demonstration()
    clouds = np.tile(table(), (FRAMES, 1, 1))
    recorded = replace(source, point_cloud_world=clouds)
    first, again = (transfer(TARGETS[0])(recorded)[0].point_cloud_world for _ in range(2))
    np.testing.assert_array_equal(first, again)


# -- demonstrations ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("qpos", "action", "message"),
    [
        (np.zeros((0, 9)), np.zeros((0, 9)), "episode 7 has no frames"),
        (np.zeros((3, 9)), np.zeros((3, 8)), "action has shape (3, 8); it should be (3, 9)"),
        (np.full((3, 9), np.nan), np.zeros((3, 9)), "qpos is not finite at frame 0, entry 0"),
        (
            np.zeros((3, 9)),
            np.where(np.arange(27) == 22, np.inf, 0).reshape(3, 9),
            "action is not finite at frame 2, entry 4",
        ),
    ],
)
def test_a_demonstration_that_cannot_be(qpos: np.ndarray, action: np.ndarray, message: str) -> None:
    with pytest.raises(CEIError) as error:
        replace(demonstration(), qpos=qpos, action=action)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
