"""The pipeline on clouds as real cameras make them: noise, outliers, holes, nothing, and not-a-number."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from conversions import record_cubes

from cei_converters import convert, replay
from cei_converters.sources.reader import DatasetReader
from cei_envs.environment import CEIEnv
from cei_envs.viewpoints import make_cameras
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import CloudOptions, CloudSynthesiser, RobotMask, crop, fuse_depth
from cei_gym.pointcloud.isolated import isolated
from cei_gym.rendering import DepthCamera
from cei_gym.transfer import Attempt, Transfer
from cei_gym.wrapper import CrossEmbodimentWrapper

SOURCE, TARGET = "Panda-PandaGripper", "UR5e-FourierRight"
CAMERAS = ["front", "left", "right"]
TAU_M = CloudOptions().tau_m
ON_TARGET = 700
ON_TARGET_OUTLIERS = 30
"""Points of a cloud of 1024 that are on the target, at least; farthest points prefer outliers."""

type Damage = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def outliers(depth_m: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """30 % of all pixels anywhere between 0.3 and 2 m."""
    return np.where(random.random(depth_m.shape) < 0.3, random.uniform(0.3, 2.0, depth_m.shape), depth_m)


def holes(depth_m: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Six rectangles without a depth in every image."""
    depth_m = depth_m.copy()
    for image in depth_m.reshape(-1, *depth_m.shape[-2:]):
        for _ in range(6):
            v, u = random.integers((100, 130))
            image[v : v + random.integers(5, 40), u : u + random.integers(5, 40)] = 0
    return depth_m


def not_a_number(depth_m: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Half of all pixels."""
    return np.where(random.random(depth_m.shape) < 0.5, np.nan, depth_m)


def nothing(depth_m: np.ndarray, _random: np.random.Generator) -> np.ndarray:
    return np.zeros_like(depth_m)


DAMAGES: list[Damage] = [outliers, holes, not_a_number, nothing]


@pytest.fixture(scope="module", params=[None, "kinect"])
def env(request: pytest.FixtureRequest) -> Iterator[CEIEnv]:
    made = gym.make(f"CEI-PickCube-{SOURCE}", cameras=CAMERAS, depth_noise=request.param).unwrapped
    assert isinstance(made, CEIEnv)
    made.reset(seed=0)
    yield made
    made.close()


@pytest.fixture(scope="module")
def synthesise() -> CloudSynthesiser:
    return CloudSynthesiser(load_embodiment(SOURCE), load_embodiment(TARGET))


def near_robot(name: str, points: np.ndarray, qpos: np.ndarray, env: CEIEnv, tau_m: float) -> np.ndarray:
    body = load_embodiment(name)
    links = env.scene.T_world_base @ KinematicTree(body).forward(qpos)
    return RobotMask(visual_link_meshes(body.model), tau_m)(points.astype(float), links)


@pytest.mark.parametrize("damage", [None, *DAMAGES])
def test_a_clouds_points_are_finite_in_the_workspace_and_of_the_target_and_the_scene(
    damage: Damage | None, env: CEIEnv, synthesise: CloudSynthesiser
) -> None:
    random, scene = np.random.default_rng(0), env.scene
    depth_m = {name: d if damage is None else damage(d, random) for name, d in env.depth_m().items()}
    qpos, workspace = env.simulation.qpos, scene.workspace_world
    target = load_embodiment(TARGET)
    kept = synthesise.remove(fuse_depth(scene, depth_m), scene, qpos)
    cloud = synthesise.add(kept, scene, target.home)
    assert cloud.shape == (1024, 3)
    assert cloud.dtype == np.float32
    assert np.isfinite(cloud).all()
    assert crop(cloud, workspace + [[-1e-6], [1e-6]]).all()
    assert not near_robot(SOURCE, kept, qpos, env, TAU_M - 1e-5).any()
    on_target = near_robot(TARGET, cloud, target.home, env, 1e-4)
    assert on_target.sum() >= (ON_TARGET_OUTLIERS if damage is outliers else ON_TARGET)
    assert on_target.all() == (damage is nothing)  # else something of the scene is in it


@pytest.mark.parametrize("damage", [None, outliers])
def test_outliers_are_dropped_where_that_is_asked_for(damage: Damage | None, env: CEIEnv) -> None:
    depth_m = env.depth_m()
    if damage is not None:
        depth_m = {name: damage(d, np.random.default_rng(0)) for name, d in depth_m.items()}
    target = load_embodiment(TARGET)
    careful = CloudSynthesiser(load_embodiment(SOURCE), target, CloudOptions(outlier_m=0.03))
    kept = careful.remove(fuse_depth(env.scene, depth_m), env.scene, env.simulation.qpos)
    cloud = careful.add(kept, env.scene, target.home)
    assert near_robot(TARGET, cloud, target.home, env, 1e-4).sum() >= 600
    cube = env.read_state()[:3]
    assert (np.linalg.norm(cloud - cube, axis=1) < 0.04).sum() >= 5


def test_of_the_source_a_stated_share_is_left(env: CEIEnv) -> None:
    """Pixels that truly show the source robot, and are farther than tau from where it should be."""
    placed = make_cameras(CAMERAS, 160, 120)  # where they are, which noise hides from `env.scene`
    truth = DepthCamera(env.model, placed).render(env.simulation.data)
    on_robot = [
        fuse_depth(env.scene, {name: np.where(np.isin(truth[name][1], env.simulation.robot_geoms), depth, 0)})
        for name, depth in env.depth_m().items()
    ]
    points = np.concatenate(on_robot)
    points = points[crop(points, env.scene.workspace_world)]
    assert len(points) > 500
    left = ~near_robot(SOURCE, points, env.simulation.qpos, env, TAU_M)
    assert left.mean() < (0.001 if env.spec.kwargs["depth_noise"] is None else 0.03)


@pytest.mark.parametrize("damage", DAMAGES)
def test_the_wrapper_shows_defined_clouds(damage: Damage, env: CEIEnv, monkeypatch: pytest.MonkeyPatch) -> None:
    random, depth_m = np.random.default_rng(0), env.depth_m
    monkeypatch.setattr(env, "depth_m", lambda: {name: damage(d, random) for name, d in depth_m().items()})
    wrapped = CrossEmbodimentWrapper(env)
    least = ON_TARGET_OUTLIERS if damage is outliers else ON_TARGET
    for observation in (wrapped.reset(seed=1)[0], wrapped.step(env.embodiment.home)[0]):
        assert wrapped.observation_space.contains(observation)
        cloud = observation["point_cloud"]
        assert near_robot(SOURCE, cloud, observation["agent_pos"].astype(float), env, 1e-4).sum() >= least


# -- a whole demonstration -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `noisy`, recorded by three noisy cameras, and `clean`, the same without noise."""
    folder = tmp_path_factory.mktemp("real")
    for name, noise in (("noisy", ["--depth_noise=kinect"]), ("clean", [])):
        record_cubes(folder / name, 1, 3, f"--cameras=[{','.join(CAMERAS)}]", *noise)
    return folder


@pytest.fixture(scope="module")
def clean(job: Path) -> Demonstration:
    return DatasetReader("me/clean", job / "clean").read(0)


@pytest.fixture(scope="module")
def transfer(clean: Demonstration) -> Transfer:
    made = Transfer(load_embodiment(SOURCE), load_embodiment(TARGET))
    made.fit([clean])
    return made


def test_noise_changes_what_is_seen_and_believed_and_nothing_else(job: Path, clean: Demonstration) -> None:
    reader = DatasetReader("me/noisy", job / "noisy")
    noisy = reader.read(0)
    assert reader.metadata is not None
    assert reader.metadata.environment.kwargs == {"cameras": CAMERAS, "depth_noise": "kinect"}
    for name in ("qpos", "action", "environment_state"):
        np.testing.assert_array_equal(getattr(noisy, name), getattr(clean, name))
    assert list(noisy.depth_m) == list(clean.depth_m) == [c.name for c in noisy.scene.cameras] == CAMERAS
    for one, other in zip(noisy.scene.cameras, clean.scene.cameras, strict=True):
        error_m = np.linalg.norm((one.T_world_camera - other.T_world_camera)[:3, 3])
        assert error_m == pytest.approx(0.002)
        off = noisy.depth_m[one.name] != clean.depth_m[one.name]
        assert 0.3 < off.mean() < 1


def test_a_noisy_demonstration_transfers_and_succeeds_in_physics(job: Path) -> None:
    noisy, target = job / "noisy", job / "target"
    options = [f"--target={TARGET}", "--new_repo_id=me/target", f"--new_root={target}"]
    assert convert.main(["--dataset.repo_id=me/noisy", f"--dataset.root={noisy}", *options]) == 0
    config = replay.ReplayConfig(replay.DatasetConfig("me/target", str(target)), video_episodes=0)
    assert replay.replay(config)["successes"] == 1


@pytest.mark.parametrize("damage", [outliers, holes])
@pytest.mark.parametrize("start", range(3))
def test_a_transfer_is_as_close_to_the_source_whatever_the_cloud(
    start: int, damage: Damage, clean: Demonstration, transfer: Transfer
) -> None:
    """Joints come from joints; what a cloud adds is obstacles, and where contact is. From whatever start: which is best may be a near tie."""
    attempt = Attempt(basin=start)
    plain, report = transfer(clean, clouds=False, attempt=attempt)
    spoilt, its_report = transfer(damaged(clean, damage), clouds=False, attempt=attempt)
    assert len(spoilt) == len(plain)
    farther_mm = its_report.pad_distance_mm - report.pad_distance_mm
    assert report.pad_distance_mm.mean() < 10.0
    assert farther_mm.mean() < 1.0
    assert np.median(farther_mm) < 1.0
    assert np.abs(farther_mm[-20:]).max() < 1.0  # what is held is held as before


def test_a_transfer_without_any_depth_is_that_without_a_cloud(clean: Demonstration, transfer: Transfer) -> None:
    empty = damaged(clean, nothing)
    blind = replace(clean, depth_m={}, point_cloud_world=None)
    moved, unseen = transfer(empty)[0], transfer(blind)[0]
    np.testing.assert_array_equal(moved.qpos, unseen.qpos)
    np.testing.assert_array_equal(moved.action, unseen.action)
    assert unseen.point_cloud_world is None
    assert moved.point_cloud_world is not None
    assert np.isfinite(moved.point_cloud_world).all()


def test_not_a_number_is_what_zero_is(clean: Demonstration, transfer: Transfer) -> None:
    spoilt = damaged(clean, not_a_number)
    zero = replace(spoilt, depth_m={name: np.nan_to_num(d) for name, d in spoilt.depth_m.items()})
    one, other = transfer(spoilt)[0], transfer(zero)[0]
    np.testing.assert_array_equal(one.qpos, other.qpos)
    np.testing.assert_array_equal(one.action, other.action)
    np.testing.assert_array_equal(one.point_cloud_world, other.point_cloud_world)  # pyright: ignore


def damaged(demonstration: Demonstration, damage: Damage) -> Demonstration:
    random = np.random.default_rng(0)
    depth_m = {name: damage(d, random).astype(np.float32) for name, d in demonstration.depth_m.items()}
    return replace(demonstration, depth_m=depth_m, point_cloud_world=None)


# -- points without company -----------------------------------------------------------------------------------------


def test_a_point_alone_is_isolated_and_one_of_a_surface_is_not() -> None:
    random = np.random.default_rng(0)
    surface = np.stack([*np.meshgrid(np.arange(6), np.arange(6)), np.zeros((6, 6))], axis=-1).reshape(-1, 3) * 0.01
    alone = random.uniform(-1, 1, (20, 3)) + [0, 0, 3]
    found = isolated(np.concatenate([surface, alone]), 0.03, 3)
    np.testing.assert_array_equal(found, np.arange(56) >= 36)


def test_isolation_agrees_with_counting() -> None:
    points = np.random.default_rng(1).uniform(0, 0.2, (300, 3))
    near = np.linalg.norm(points[:, None] - points, axis=-1) <= 0.03
    for neighbours in (1, 3, 8):
        np.testing.assert_array_equal(isolated(points, 0.03, neighbours), near.sum(axis=1) - 1 < neighbours)
    assert isolated(np.zeros((0, 3)), 0.03, 3).shape == (0,)
