"""Pictures painted as they come, against the true ones: the shown robot's own simulation, with joints and objects as they are."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from conversions import records

from cei_converters import convert, record
from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.rollout import record_episode
from cei_gym.embodiment import load_embodiment
from cei_gym.environment import robot_environment
from cei_gym.errors import CEIError
from cei_gym.painting import LivePainter
from cei_gym.transfer import Transfer
from cei_gym.wrapper import CrossEmbodimentWrapper
from lerobot_env_cei.configuration import CEIEnvConfig

SOURCE, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
SIZE = {"image_width": 200, "image_height": 150}
OFF = 10
"""Of 255: more differs."""


@dataclass(frozen=True)
class Played:
    """An episode: what the acting robot's camera saw, what was shown to the policy, and what it should have been; each (T, H, W, 3)."""

    seen: np.ndarray
    shown: np.ndarray
    true: np.ndarray
    thing: np.ndarray
    """(T, H, W) bool, where the true pictures show the cube."""


def off(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.abs(one.astype(int) - other).max(axis=-1) > OFF


@pytest.fixture(scope="module")
def impersonated() -> Iterator[Any]:
    home = open_environment(f"CEI-PickCube-{SOURCE}")
    transfer = Transfer(load_embodiment(SOURCE), load_embodiment(TARGET))
    transfer.fit([record_episode(home, seed, seed)[0] for seed in (0, 1)])
    home.close()
    env = CrossEmbodimentWrapper(
        gym.make(f"CEI-PickCube-{TARGET}", pixels=True, colours=True, **SIZE), impersonate=transfer
    )
    yield env
    env.close()


def play(env: Any, seed: int) -> Played:
    """The Panda's expert picks the cube with the other robot."""
    own: Any = gym.make(f"CEI-PickCube-{SOURCE}", pixels=True, **SIZE)
    seen, shown, true, thing = [], [], [], []
    observation, info = env.reset(seed=seed)
    plan = own.unwrapped.expert(seed).plan(observation["agent_pos"], observation["environment_state"])
    for action in [*plan, *[plan[-1]] * 40]:
        qpos, state = observation["agent_pos"], observation["environment_state"]
        away = state + np.eye(len(state), dtype=np.float32)[1] * 5
        pictures = [
            own.reset(seed=0, options={"agent_pos": qpos, "environment_state": which})[0]["pixels"]["front"]
            for which in (state, away)
        ]
        seen.append(robot_environment(env).channels()["rgb"]["front"])
        shown.append(observation["pixels"]["front"])
        true.append(pictures[0])
        thing.append((pictures[0] != pictures[1]).any(axis=-1))
        observation, _, ended, truncated, info = env.step(action.astype(np.float32))
        if ended or truncated:
            break
    own.close()
    assert info["is_success"]
    return Played(*map(np.stack, (seen, shown, true, thing)))


@pytest.fixture(scope="module")
def played(impersonated: Any) -> Played:
    return play(impersonated, 2)


def test_a_policy_sees_its_own_robot(played: Played) -> None:
    assert off(played.seen, played.true).mean() > 0.08
    assert off(played.shown, played.true).mean() < 0.015


def test_what_is_held_is_seen(played: Played) -> None:
    """In the last pictures the cube is in the hand, half of it behind the acting robot's fingers."""
    last = slice(-5, None)
    cube = played.true[last][played.thing[last]].mean(axis=0)
    shown = played.shown[last][played.thing[last]].astype(float)
    red = np.abs(shown - cube).max(axis=-1) < 60
    assert red.mean() > 0.6
    hidden = np.abs(played.seen[last][played.thing[last]].astype(float) - cube).max(axis=-1) >= 60
    assert hidden.mean() > 0.3  # or the test says nothing


def test_an_episode_does_not_depend_on_those_before(impersonated: Any, played: Played) -> None:
    play(impersonated, 3)
    np.testing.assert_array_equal(play(impersonated, 2).shown, played.shown)


def test_where_what_is_seen_has_no_depth_pictures_are_painted_all_the_same() -> None:
    env = open_environment(f"CEI-PickCube-{TARGET}", pixels=True, **SIZE)
    inner = robot_environment(env)
    observation, _ = env.reset(seed=2)
    qpos = observation["agent_pos"].astype(float)
    robot, base = load_embodiment(TARGET), inner.scene.T_world_base
    painter = LivePainter(robot, robot, base, base, inner.scene.cameras[0], inner.scene.support_z_m)
    picture = observation["pixels"]["front"]
    painted = painter(picture, qpos, qpos)
    env.close()
    assert off(painted, picture).mean() < 0.01
    painter.reset()
    unknown = np.where(np.indices((150, 200)).sum(axis=0) % 2, np.nan, np.inf)
    np.testing.assert_array_equal(painter(picture, qpos, qpos, unknown, holds=True), painted)
    with pytest.raises(CEIError, match=r"a picture of front should be \(150, 200, 3\), as its calibration says, not"):
        painter(picture[:100], qpos, qpos)
    with pytest.raises(CEIError, match=r"depth of front should be \(150, 200\), as its calibration says, not"):
        painter(picture, qpos, qpos, unknown[:100])


def test_a_robot_painted_over_itself_looks_the_same() -> None:
    env: Any = CrossEmbodimentWrapper(gym.make(f"CEI-PickCube-{TARGET}", pixels=True, colours=True, **SIZE), paint=True)
    inner = robot_environment(env)
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    different = [off(observation["pixels"]["front"], inner.rgb()["front"]).mean()]
    for _ in range(5):
        observation, *_ = env.step(env.action_space.sample())
        different.append(off(observation["pixels"]["front"], inner.rgb()["front"]).mean())
    assert env.observation_space.contains(observation)
    env.close()
    assert 0 < max(different) < 0.02


def test_pixels_are_the_pictures_of_the_cameras() -> None:
    env: Any = open_environment(f"CEI-PickCube-{TARGET}", pixels=True, clouds=False, cameras=["front", "left"])
    coloured: Any = open_environment(f"CEI-PickCube-{TARGET}", colours=True, cameras=["front", "left"])
    observation, _ = env.reset(seed=0)
    coloured.reset(seed=0)
    assert "point_cloud" not in observation
    assert env.observation_space.contains(observation)
    for name, picture in robot_environment(coloured).channels()["rgb"].items():
        np.testing.assert_array_equal(observation["pixels"][name], picture)
    assert not robot_environment(env).rgb()
    env.close()
    coloured.close()


def test_nothing_to_paint_is_refused() -> None:
    env = gym.make(f"CEI-PickCube-{TARGET}")
    with pytest.raises(CEIError, match=r"observations have no 'pixels'.*pixels=True"):
        CrossEmbodimentWrapper(env, paint=True)
    env.close()


def test_a_camera_that_is_not_calibrated_is_refused() -> None:
    env: Any = gym.make(f"CEI-PickCube-{TARGET}", pixels=True)
    scene = env.unwrapped.scene
    wrist = replace(scene, cameras=tuple(replace(camera, name="wrist") for camera in scene.cameras))
    with pytest.raises(CEIError, match=r"calibrated, 'front'.*wrist"):
        CrossEmbodimentWrapper(env, paint=True, scene=wrist)
    small = replace(scene, cameras=tuple(replace(camera, width=80) for camera in scene.cameras))
    with pytest.raises(CEIError, match=r"calibration is of uint8, \(120, 80, 3\)"):
        CrossEmbodimentWrapper(env, paint=True, scene=small)
    env.close()


def test_pictures_that_trail_the_joints_are_painted_at_the_joints_that_they_show() -> None:
    env: Any = open_environment(f"CEI-PickCube-{TARGET}", pixels=True, **SIZE)
    inner = robot_environment(env)
    robot, scene = load_embodiment(TARGET), inner.scene
    (camera,), base = scene.cameras, scene.T_world_base
    late = LivePainter(robot, robot, base, base, replace(camera, lag_s=0.1), scene.support_z_m, dt_s=0.05)
    in_time = LivePainter(robot, robot, base, base, camera, scene.support_z_m)
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    joints, pictures = [], []
    for _ in range(8):
        joints.append(observation["agent_pos"].astype(float))
        pictures.append(observation["pixels"]["front"])
        observation, *_ = env.step(0.9 * observation["agent_pos"] + 0.1 * env.action_space.sample())
    env.close()
    for t, qpos in enumerate(joints):
        seen = max(t - 2, 0)
        np.testing.assert_array_equal(
            late(pictures[seen], qpos, qpos), in_time(pictures[seen], joints[seen], joints[seen])
        )
    with pytest.raises(CEIError, match=r"trail the joints by 0.1 s; give the time between them"):
        LivePainter(robot, robot, base, base, replace(camera, lag_s=0.1), scene.support_z_m)


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`recorded` with pictures, and of it `painted` and `plain`."""
    folder = tmp_path_factory.mktemp("datasets")
    assert not record.main(
        [f"--env=CEI-PickCube-{SOURCE}", "--episodes=1", "--colours", "--repo_id=me/r", f"--root={folder}/recorded"]
    )
    for name, options in (("painted", ["--cameras.paint"]), ("plain", []), ("none", ["--cameras.keep=none"])):
        given = ["--dataset.repo_id=me/r", f"--dataset.root={folder}/recorded", f"--target={TARGET}"]
        assert not convert.main([*given, f"--new_repo_id=me/{name}", f"--new_root={folder}/{name}", *options])
    return folder


@pytest.mark.parametrize(
    ("name", "pixels", "paint"),
    [("painted", True, True), ("plain", True, False), ("none", False, False), ("recorded", True, False)],
)
def test_policies_get_pictures_as_their_dataset_has_them(datasets: Path, name: str, pixels: bool, paint: bool) -> None:
    config = CEIEnvConfig(dataset=str(datasets / name))
    assert (config.pixels, config.paint) == (pixels, paint)
    key = "observation.images.front"
    assert (key in config.features_map.values()) == pixels
    ((env,),) = (of.values() for of in config.create_envs(1).values())
    observation, _ = env.reset(seed=[0])
    env.close()
    if pixels:
        assert config.features["pixels/front"].shape == observation["pixels"]["front"].shape[1:]


def test_painted_pictures_are_as_those_of_the_dataset(datasets: Path) -> None:
    """The first picture of a conversion, and what a policy sees from the same start."""
    from cei_converters.sources.reader import DatasetReader

    reader = DatasetReader("me/painted", datasets / "painted")
    assert records(datasets / "painted")[0]["painted"] == ["observation.images.front"]
    config = CEIEnvConfig(dataset=str(datasets / "painted"))
    ((env,),) = (of.values() for of in config.create_envs(1).values())
    first = reader.read(0)
    assert first.environment_state is not None
    options = {"agent_pos": first.qpos[0], "environment_state": first.environment_state[0]}
    observation, _ = env.reset(seed=[0], options=options)
    env.close()
    assert (
        off(observation["pixels"]["front"][0], reader.pictures(0).decode("observation.images.front")[0]).mean() < 0.01
    )


def test_painting_without_pictures_is_refused(datasets: Path) -> None:
    with pytest.raises(CEIError, match=r"--env.paint paints what --env.pixels shows"):
        CEIEnvConfig(dataset=str(datasets / "none"), paint=True)
