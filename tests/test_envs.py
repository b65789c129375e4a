"""The environments: contract, reproducibility, success, and what making one does not need."""

import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from outcomes import outcome
from rollouts import make, wander
from scipy.spatial import KDTree

from cei_envs import environment_id, environment_ids
from cei_envs.environment import CEIEnv
from cei_envs.experts import make_expert
from cei_envs.gripper import KINDS, register_gripper
from cei_envs.registration import OWN, tasks
from cei_envs.simulation import CONTROL_HZ
from cei_envs.tasks.pick_cube import PickCubeEnv
from cei_envs.viewpoints import VIEWPOINTS
from cei_gym.embodiment import (
    ARMS,
    END_EFFECTORS,
    GRID,
    EndEffectorSpec,
    PhysicsException,
    arm_names,
    end_effector_names,
    load_arm,
    load_end_effector,
)
from cei_gym.errors import CEIError
from cei_gym.pointcloud import crop
from cei_gym.rendering import DepthCamera, unproject

NAMES = ["Panda-PandaGripper", "IIWA-Inspire", "UR5e-RobotiqThreeFinger"]
EXPERT = "CEI-PickCube-Panda-PandaGripper"


@pytest.fixture(scope="module")
def envs() -> Iterator[dict[str, CEIEnv]]:
    made = {name: make("PickCube", name) for name in NAMES}
    yield made
    for env in made.values():
        env.close()


def rollout(env: CEIEnv, actions: np.ndarray, **reset) -> list[dict[str, np.ndarray]]:
    observations = [env.reset(**reset)[0]]
    for action in actions:
        observations.append(env.step(action)[0])
    return observations


def assert_same(one: list[dict[str, np.ndarray]], other: list[dict[str, np.ndarray]]) -> None:
    for a, b in zip(one, other, strict=True):
        for key in a:
            np.testing.assert_array_equal(a[key], b[key], err_msg=key)


def run_python(code: str, **environment: str) -> str:
    """Standard output of a fresh interpreter."""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **environment}
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


# -- registration --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("task", ["OpenDrawer", "PickCube", "StackCube"])
@pytest.mark.parametrize("name", [*GRID, "XArm7-XHand"])
def test_every_embodiment_has_an_environment(name: str, task: str) -> None:
    assert environment_id(task, name) == f"CEI-{task}-{name}"
    spec = gym.spec(environment_id(task, name))
    assert spec.kwargs["embodiment"] == name
    assert spec.max_episode_steps == 400


def test_all_environments_are_registered_once() -> None:
    ids = environment_ids()
    assert len(set(ids)) == len(ids) == len(tasks()) * len(arm_names()) * len(end_effector_names())
    code = "import cei_gym, gymnasium\nprint(*(name for name in gymnasium.registry if name.startswith('CEI-')))"
    assert sorted(run_python(code).split()) == sorted(
        ids
    )  # in this process other tests may have had robots of their own


def test_the_prefixed_id_imports_and_makes() -> None:
    code = """
import gymnasium
env = gymnasium.make("cei_gym:CEI-PickCube-IIWA-Inspire")
observation, info = env.reset(seed=0)
print(env.observation_space.contains(observation), env.unwrapped.embodiment.name)
"""
    assert run_python(code, MUJOCO_GL="disable").splitlines()[-1] == "True IIWA-Inspire"


def test_making_an_environment_needs_neither_torch_nor_lerobot() -> None:
    code = """
import sys
import cei_envs
assert not {"robosuite", "mujoco"} & set(sys.modules)
import gymnasium
env = gymnasium.make(cei_envs.environment_ids()[0])
env.reset(seed=0)
env.step(env.unwrapped.embodiment.home)
heavy = {"torch", "lerobot", "pytorch_kinematics", "datasets", "mink"}
print("heavy:", sorted(heavy & set(sys.modules)))
"""
    assert run_python(code).splitlines()[-1] == "heavy: []"


@pytest.mark.parametrize(("name", "valid"), [("IIWA-Inspir", "FourierRight, Inspire"), ("Inspire", "UR5e, IIWA")])
def test_an_unknown_embodiment_lists_the_valid_parts(name: str, valid: str) -> None:
    with pytest.raises(CEIError, match=f"Valid: {valid}, "):
        gym.make(environment_id("PickCube", NAMES[0]), embodiment=name)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"max_hold_ticks": 0}, "max_hold_ticks is at least 1"),
        ({"render_mode": "human"}, "render_mode 'human'"),
        ({"cameras": ["frnt"]}, "unknown camera 'frnt'. Did you mean 'front'?"),
        ({"cameras": []}, "cameras are one or more different names of front, left, right, top"),
        ({"cameras": ["top", "top"]}, "cameras are one or more different names"),
        ({"cameras": "top"}, "cameras are one or more different names"),
        ({"depth_noise": "kinct"}, "unknown depth noise 'kinct'. Did you mean 'kinect'?"),
    ],
)
def test_arguments_are_checked(arguments: dict, message: str) -> None:
    with pytest.raises(CEIError, match=message):
        PickCubeEnv(NAMES[0], **arguments)


# -- contract ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_checks_the_environment(name: str, envs: dict[str, CEIEnv]) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(envs[name], skip_render_check=True)
    # Joint targets are in rad and m, and nothing bounds what physics does to a joint.
    meant = ("normalized", "value is -infinity", "value is infinity", "different from the unwrapped version")
    rest = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    assert not [message for message in rest if not any(m in message for m in meant)]


@pytest.mark.parametrize("name", NAMES)
def test_observations(name: str, envs: dict[str, CEIEnv]) -> None:
    env = envs[name]
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert observation["point_cloud"].shape == (1024, 3)
    assert len(observation["environment_state"]) == len(env.state_names)
    assert outcome(info) == {"is_success": False, "failure": "never grasped"}
    body = env.embodiment
    assert np.abs(observation["agent_pos"] - body.home)[: body.n_arm].max() < 0.1
    np.testing.assert_allclose(observation["agent_pos"][body.n_arm :], body.home[body.n_arm :], atol=1e-6)
    # The cube is in the cloud: points within its box, as the state describes it.
    x, y, z, *_, mass = observation["environment_state"]
    half = observation["environment_state"][7:10]
    near = np.linalg.norm(observation["point_cloud"] - [x, y, z], axis=1) < np.linalg.norm(half) + 1e-3
    assert near.sum() > 10
    assert mass == pytest.approx(1000 * 8 * half.prod(), rel=1e-5)


def test_starts_are_spread_and_stand_on_the_table(envs: dict[str, CEIEnv]) -> None:
    env = envs[NAMES[0]]
    states = np.array([env.reset(seed=seed)[0]["environment_state"] for seed in range(12)])
    assert np.abs(states[:, :2]).max() <= 0.1
    assert (np.ptp(states[:, :2], axis=0) > 0.1).all()
    np.testing.assert_allclose(states[:, 2], 0.8 + states[:, 9], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(states[:, 3:7], axis=1), 1, atol=1e-6)
    assert np.ptp(states[:, 3]) > 0.3
    half = states[:, 7:10]
    assert (half >= 0.02).all()
    assert (half <= 0.022).all()


@pytest.mark.parametrize("name", NAMES)
def test_one_seed_gives_one_episode(name: str, envs: dict[str, CEIEnv]) -> None:
    env, other = envs[name], make("PickCube", name)
    actions = wander(env, 5)
    first = rollout(env, actions, seed=3)
    assert_same(first, rollout(other, actions, seed=3))
    assert_same(first, rollout(env, actions, seed=3))  # whatever happened in between
    different = rollout(env, actions, seed=4)
    assert not np.array_equal(first[0]["environment_state"], different[0]["environment_state"])
    assert not np.array_equal(first[0]["agent_pos"], different[0]["agent_pos"])
    other.close()


@pytest.mark.parametrize("name", NAMES)
def test_a_recorded_start_is_restored_exactly(name: str, envs: dict[str, CEIEnv]) -> None:
    env = envs[name]
    actions = wander(env, 5, seed=1)
    recorded = rollout(env, actions, seed=5)
    start = {key: recorded[0][key] for key in ("environment_state", "agent_pos")}
    rollout(env, wander(env, 2, seed=2), seed=6)
    assert_same(rollout(env, actions, seed=7, options=start), recorded)
    assert_same(rollout(env, actions, options=start), recorded)


def test_episodes_start_where_they_are_told_to() -> None:
    home = make("PickCube", NAMES[0], clouds=False)
    starts = [(home.embodiment.home + away).tolist() for away in (0.3, -0.3)]
    one, two = (
        make("PickCube", NAMES[0], clouds=False, start_qpos=starts[0]),
        make("PickCube", NAMES[0], clouds=False, start_qpos=starts),
    )
    same = pickle.loads(pickle.dumps(two))
    arm, chosen = slice(one.embodiment.n_arm), []
    for seed in range(12):
        found = home.reset(seed=seed)[0], one.reset(seed=seed)[0], two.reset(seed=seed)[0], same.reset(seed=seed)[0]
        np.testing.assert_array_equal(found[0]["environment_state"], found[1]["environment_state"])
        np.testing.assert_allclose((found[1]["agent_pos"] - found[0]["agent_pos"])[arm], 0.3, atol=1e-5)
        np.testing.assert_array_equal(found[2]["agent_pos"], found[3]["agent_pos"])
        away = [np.abs(found[2]["agent_pos"] - start)[arm].max() for start in starts]
        assert min(away) < 0.1 < max(away)
        chosen.append(int(np.argmin(away)))
    assert set(chosen) == {0, 1}
    for env in (home, one, two, same):
        env.close()


@pytest.mark.parametrize("start", [[0.0] * 8, [[0.0] * 8], [float("nan")] * 9, "home", []])
def test_a_start_of_the_wrong_kind_is_refused(start: object) -> None:
    with pytest.raises(CEIError, match=r"^start_qpos is 9 finite joint positions of Panda-PandaGripper"):
        make("PickCube", NAMES[0], start_qpos=start)


@pytest.mark.parametrize("name", NAMES)
def test_a_pickled_environment_goes_on_alike(name: str, envs: dict[str, CEIEnv]) -> None:
    env = envs[name]
    copy = pickle.loads(pickle.dumps(env))
    actions = wander(env, 3)
    assert_same(rollout(copy, actions, seed=2), rollout(env, actions, seed=2))
    copy.close()


def test_pickling_keeps_the_arguments() -> None:
    env = make("PickCube", NAMES[0], max_hold_ticks=2, image_width=40, image_height=30, render_mode="rgb_array")
    copy = pickle.loads(pickle.dumps(env))
    copy.reset(seed=0)
    far, began_s = copy.embodiment.home.copy(), copy.simulation.data.time
    far[0] += 1.0
    copy.step(far)
    assert copy.simulation.data.time - began_s == pytest.approx(2 / CONTROL_HZ)
    assert copy.depth_m()["front"].shape == (30, 40)
    picture = copy.render()
    assert (picture.shape, picture.dtype) == ((240, 320, 3), np.uint8)
    assert picture.std() > 10
    env.close()
    copy.close()


def test_noise_is_of_a_seed_and_changes_neither_starts_nor_physics(envs: dict[str, CEIEnv]) -> None:
    env, noisy = envs[NAMES[0]], make("PickCube", NAMES[0], depth_noise="kinect")
    actions = wander(env, 5)
    clean, seen = rollout(env, actions, seed=3), rollout(noisy, actions, seed=3)
    for one, other in zip(clean, seen, strict=True):
        for key in ("agent_pos", "environment_state"):
            np.testing.assert_array_equal(one[key], other[key])
        assert not np.array_equal(one["point_cloud"], other["point_cloud"])
        assert noisy.observation_space.contains(other)
    assert_same(rollout(noisy, actions, seed=3), seen)
    assert_same(rollout(pickle.loads(pickle.dumps(noisy)), actions, seed=3), seen)
    first = noisy.reset(seed=3)[0]
    start = {key: first[key] for key in ("environment_state", "agent_pos")}
    again = noisy.reset(options=start)[0]  # the next episode of the stream
    assert not np.array_equal(again["point_cloud"], first["point_cloud"])
    noisy.close()


def test_options_that_are_left_out_leave_observations_as_they_are(envs: dict[str, CEIEnv]) -> None:
    env, other = envs[NAMES[0]], make("PickCube", NAMES[0], cameras=["front"], depth_noise={})
    actions = wander(env, 5)
    assert_same(rollout(other, actions, seed=3), rollout(env, actions, seed=3))
    np.testing.assert_array_equal(env.scene.cameras[0].T_world_camera, other.scene.cameras[0].T_world_camera)
    images = DepthCamera(env.model, env.scene.cameras).render(env.simulation.data)
    whole_mm = np.rint(images["front"][0] * np.float32(1000)) / np.float32(1000)
    np.testing.assert_array_equal(env.depth_m()["front"], whole_mm)
    other.close()


def test_colours_are_those_of_the_pictures(envs: dict[str, CEIEnv]) -> None:
    env, plain = make("PickCube", NAMES[0], colours=True), envs[NAMES[0]]
    cloud = env.reset(seed=3)[0]["point_cloud"]
    assert env.observation_space["point_cloud"].contains(cloud)
    np.testing.assert_array_equal(cloud[:, :3], plain.reset(seed=3)[0]["point_cloud"])
    assert plain.rgb() == {}
    depth_m, picture = env.depth_m()["front"], env.rgb()["front"]
    points = unproject(depth_m, env.scene.cameras[0]).astype(np.float32)
    colour_of = dict(zip(map(bytes, points), (picture[depth_m > 0] / 255).astype(np.float32), strict=True))
    for point in cloud:
        np.testing.assert_array_equal(point[3:], colour_of[bytes(point[:3])])
    env.close()


@pytest.mark.parametrize("task", [task.name for task in OWN])
def test_every_camera_sees_the_task_and_clouds_fuse_them(task: str) -> None:
    env = gym.make(environment_id(task, NAMES[0]), cameras=list(VIEWPOINTS)).unwrapped
    assert isinstance(env, CEIEnv)
    for seed in range(3):
        observation = env.reset(seed=seed)[0]
        cloud = observation["point_cloud"]
        state = dict(zip(env.state_names, observation["environment_state"], strict=True))
        middle = np.array([*(np.mean([v for k, v in state.items() if k.endswith(f".{axis}_m")]) for axis in "xy"), 0.9])
        assert list(env.depth_m()) == list(VIEWPOINTS)
        seen = {c.name: unproject(env.depth_m()[c.name], c) for c in env.scene.cameras}
        for points in seen.values():
            points = points[crop(points, env.scene.workspace_world)]
            assert (np.linalg.norm(points - middle, axis=1) < 0.2).sum() > 20
        every = np.concatenate(list(seen.values())).astype(np.float32)
        assert KDTree(every).query(cloud)[0].max() == 0
        for points in seen.values():  # none of them sees all of it
            assert KDTree(points.astype(np.float32)).query(cloud)[0].max() > 0
    env.close()


def test_a_calibrations_error_is_in_the_scene_and_not_in_the_image() -> None:
    noise = {"tilt_deg": 2.0, "shift_m": 0.01}
    env, exact = make("PickCube", NAMES[0], depth_noise=noise), make("PickCube", NAMES[0])
    for one in (env, exact):
        one.reset(seed=0)
    np.testing.assert_array_equal(env.depth_m()["front"], exact.depth_m()["front"])
    believed, true = env.scene.cameras[0].T_world_camera, exact.scene.cameras[0].T_world_camera
    assert np.linalg.norm((believed - true)[:3, 3]) == pytest.approx(0.01)
    cosine = (np.trace(believed[:3, :3].T @ true[:3, :3]) - 1) / 2
    assert np.rad2deg(np.arccos(cosine)) == pytest.approx(2.0)
    for one in (env, exact):
        one.close()


@pytest.mark.parametrize("name", NAMES)
def test_actions_outside_limits_are_clipped(name: str, envs: dict[str, CEIEnv]) -> None:
    env = envs[name]
    body = env.embodiment
    wild = np.where(np.arange(len(body.home)) < body.n_arm, body.home, 100.0)
    at_limit = np.where(np.arange(len(body.home)) < body.n_arm, body.home, body.upper)
    assert_same(rollout(env, wild[None], seed=0), rollout(env, at_limit[None], seed=0))


@pytest.mark.parametrize("name", NAMES)
def test_a_step_waits_until_the_joints_are_there(name: str, envs: dict[str, CEIEnv]) -> None:
    env = envs[name]
    body = env.embodiment
    env.reset(seed=0)
    target = body.home.copy()
    target[: body.n_arm] += 0.1
    time = env.simulation.data.time
    observation = env.step(target)[0]
    assert 2 <= round((env.simulation.data.time - time) * 20) <= 5
    assert np.abs(observation["agent_pos"] - target)[: body.n_arm].max() < 0.05
    for _ in range(5):  # a target held long enough is reached to the tolerance
        observation = env.step(target)[0]
    assert np.abs(observation["agent_pos"] - target)[: body.n_arm].max() < 0.02
    time = env.simulation.data.time
    env.step(target)  # and one that is reached takes a single control period
    assert round((env.simulation.data.time - time) * 20) == 1


@pytest.mark.parametrize("name", NAMES)
def test_a_step_says_how_long_it_took(name: str, envs: dict[str, CEIEnv]) -> None:
    env = envs[name]
    assert env.reset(seed=0)[1]["step_time_s"] == 0
    target, took = env.embodiment.home.astype(np.float32), []
    for shift in (0.1, 0.0, 0.0, 0.0, 0.0, 0.0):
        target[: env.embodiment.n_arm] += shift
        before = env.simulation.data.time
        took.append(env.step(target)[4]["step_time_s"])
        assert took[-1] == pytest.approx(env.simulation.data.time - before)
    assert took[0] > took[-1] == 1 / CONTROL_HZ and max(took) <= env.longest_step_s == 0.25


@pytest.mark.parametrize(
    "action",
    [
        *(np.zeros(3), np.zeros((1, 9)), np.full(9, np.nan), np.where(np.arange(9) == 4, np.inf, 0), 0.0),
        *("abc", ["1"] * 9, None, [[0.0], [0.0, 1.0]], np.zeros(9, bool), np.zeros(9, complex), np.zeros(9, object)),
    ],
    ids=lambda action: str(action)[:20],
)
def test_actions_that_cannot_be_are_refused(action: Any, envs: dict[str, CEIEnv]) -> None:
    env = envs[NAMES[0]]
    env.reset(seed=0)
    before = env.simulation.data.time
    with pytest.raises(CEIError) as error:
        env.step(action)
    assert "is 9 finite joint targets" in str(error.value)
    assert "\n" not in str(error.value)
    assert env.simulation.data.time == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"state": np.zeros(11)}, "unknown reset option 'state'. Valid: environment_state, agent_pos, friction_scale."),
        ({"environment_state": np.zeros(10)}, "'environment_state' is 11 finite numbers"),
        ({"agent_pos": np.zeros(8)}, "'agent_pos' is 9 finite numbers"),
        ({"agent_pos": np.full(9, np.nan)}, "'agent_pos' is 9 finite numbers"),
        ({"agent_pos": "home"}, "'agent_pos' is 9 finite numbers, not <U4 of shape ()"),
        ({"agent_pos": None}, "'agent_pos' is 9 finite numbers, not object of shape ()"),
        ({1: 2}, "unknown reset option '1'"),
        ({"friction_scale": 0.0}, "'friction_scale' is a number above 0, not 0.0."),
        ({"friction_scale": [1.0, 2.0]}, "'friction_scale' is a number above 0, not [1.0, 2.0]."),
        (3, "reset options are a mapping of environment_state, agent_pos, friction_scale, not 3."),
    ],
)
def test_reset_options_are_checked(options: dict, message: str, envs: dict[str, CEIEnv]) -> None:
    with pytest.raises(CEIError) as error:
        envs[NAMES[0]].reset(options=options)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("seed", [-1, 1.5, "a", np.int64(-1)])
def test_a_seed_that_is_none_is_refused(seed: Any, envs: dict[str, CEIEnv]) -> None:
    with pytest.raises(CEIError, match=rf"^a seed is a whole number, at least 0, not {seed}\.$"):
        envs[NAMES[0]].reset(seed=seed)
    first, _ = envs[NAMES[0]].reset(seed=3)
    again, _ = envs[NAMES[0]].reset(seed=np.int64(3))  # pyright: ignore[reportArgumentType]
    np.testing.assert_array_equal(first["environment_state"], again["environment_state"])


def test_before_an_episode_and_after_the_end_there_is_one_clear_error() -> None:
    env = gym.make(f"CEI-PickCube-{NAMES[0]}", clouds=False, render_mode="rgb_array")
    inner, action = env.unwrapped, np.zeros(9, np.float32)
    with pytest.raises(CEIError, match=r"^no episode has begun: call reset\(\) before step\(\)\.$"):
        inner.step(action)
    with pytest.raises(gym.error.ResetNeeded):  # Gymnasium's own word for it
        env.step(action)
    env.reset(seed=0)
    env.step(inner.embodiment.home)  # pyright: ignore[reportAttributeAccessIssue]
    env.close()
    env.close()
    for call in (lambda: env.step(action), lambda: env.reset(seed=0), env.render, lambda: inner.step(action)):
        with pytest.raises(CEIError, match=r"^the environment is closed; make another one, with gym\.make\.$"):
            call()


# -- the task ------------------------------------------------------------------------------------------------


class Episode:
    """An expert's demonstration, and what physics said at every control period."""

    def __init__(self, env: CEIEnv, seed: int) -> None:
        observation, _ = env.reset(seed=seed)
        self.start = observation
        expert = make_expert("PickCube", env.embodiment, env.scene.T_world_base, seed)
        self.actions = expert.plan(observation["agent_pos"], observation["environment_state"])
        self.lift, self.rewards, self.info = play(env, self.actions)


def play(env: CEIEnv, actions: np.ndarray) -> tuple[np.ndarray, list[float], dict]:
    """Cube heights above the start after each step, rewards, last info; holds the last target for a while."""
    start, lift, rewards, info = env.read_state()[2], [], [], {}
    for action in [*actions, *[actions[-1]] * 20]:
        observation, reward, terminated, _, info = env.step(action)
        lift.append(observation["environment_state"][2] - start)
        rewards.append(reward)
        assert terminated == info["is_success"] == bool(reward)
        if terminated:
            break
    return np.array(lift), rewards, info


@pytest.fixture(scope="module")
def episode(envs: dict[str, CEIEnv]) -> Episode:
    return Episode(envs[NAMES[0]], 0)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_expert_lifts_the_cube(seed: int, envs: dict[str, CEIEnv]) -> None:
    episode = Episode(envs[NAMES[0]], seed)
    assert outcome(episode.info) == {"is_success": True, "failure": ""}
    assert episode.lift[-1] >= 0.05
    assert episode.rewards[:-1] == [0.0] * (len(episode.rewards) - 1)
    assert episode.rewards[-1] == 1.0


def test_experts_differ_by_seed_and_repeat_by_seed(envs: dict[str, CEIEnv], episode: Episode) -> None:
    env, start = envs[NAMES[0]], episode.start
    plans = [
        make_expert("PickCube", env.embodiment, env.scene.T_world_base, seed).plan(
            start["agent_pos"], start["environment_state"]
        )
        for seed in (0, 0, 1)
    ]
    np.testing.assert_array_equal(plans[0], plans[1])
    assert plans[0].shape != plans[2].shape or np.abs(plans[0] - plans[2]).max() > 0.01


def test_a_target_without_an_expert_says_which_has_one(envs: dict[str, CEIEnv]) -> None:
    env = envs["IIWA-Inspire"]
    with pytest.raises(
        CEIError, match=r"no scripted expert for CEI-StackCube-IIWA-Inspire.*CEI-StackCube-<Arm>-PandaGripper"
    ):
        make_expert("StackCube", env.embodiment, env.scene.T_world_base, 0)


def test_the_expert_succeeds_again_from_its_restored_start(envs: dict[str, CEIEnv], episode: Episode) -> None:
    env = envs[NAMES[0]]
    start = {key: episode.start[key] for key in ("environment_state", "agent_pos")}
    env.reset(seed=99, options=start)
    lift, _, info = play(env, episode.actions)
    assert info["is_success"]
    np.testing.assert_array_equal(lift, episode.lift)


def test_a_blind_replay_mostly_fails(envs: dict[str, CEIEnv], episode: Episode) -> None:
    env = envs[NAMES[0]]
    successes = []
    for seed in range(10, 15):
        env.reset(seed=seed)
        successes.append(play(env, episode.actions)[2]["is_success"])
    assert sum(successes) <= 1


def test_a_cube_that_is_only_high_for_a_moment_is_no_success(envs: dict[str, CEIEnv]) -> None:
    env = envs[NAMES[0]]
    env.reset(seed=0)
    env.simulation.data.joint("cube_joint0").qpos[2] += 0.12  # falls for 0.16 s: high for three periods
    mujoco.mj_forward(env.model, env.simulation.data)
    infos = [env.step(env.embodiment.home)[4] for _ in range(12)]
    assert not any(info["is_success"] for info in infos)
    assert infos[-1]["failure"] == "dropped"


def test_no_object_moves_without_contact(envs: dict[str, CEIEnv], episode: Episode) -> None:
    """Before the first touch the cube rests; in the air only fingers touch it, and it is released when they open."""
    env = envs[NAMES[0]]
    start = {key: episode.start[key] for key in ("environment_state", "agent_pos")}
    env.reset(options=start)
    data, model, cube = env.simulation.data, env.model, env.model.body("cube_main").id

    def touched_by() -> set[str]:
        bodies = model.geom_bodyid[data.contact.geom]
        pairs = bodies[(bodies == cube).any(axis=1)]
        return {model.body(b).name for pair in pairs for b in pair if b != cube}

    first, highest = env.read_state()[:3], 0.0
    for action in episode.actions:
        terminated = env.step(action)[2]
        by_robot = {name for name in touched_by() if name.startswith(("robot0_", "gripper0_"))}
        position = env.read_state()[:3]
        highest = max(highest, position[2] - first[2])
        if not by_robot and highest < 0.01:
            assert np.abs(position - first).max() < 1e-3
        if position[2] > first[2] + 0.005:
            assert by_robot
            assert all("finger" in name for name in by_robot)
        if terminated:
            break
    assert position[2] > first[2] + 0.05
    opened = env.simulation.qpos
    opened[env.embodiment.n_arm :] = env.embodiment.home[env.embodiment.n_arm :]
    for _ in range(10):
        env.step(opened)
    assert env.read_state()[2] < first[2] + 0.01


def test_a_cube_left_alone_stays(envs: dict[str, CEIEnv]) -> None:
    for env in envs.values():
        observation, _ = env.reset(seed=2)
        before = observation["environment_state"]
        for _ in range(10):
            observation, _, _, _, info = env.step(env.embodiment.home)
        np.testing.assert_allclose(observation["environment_state"], before, atol=1e-3)
        assert outcome(info) == {"is_success": False, "failure": "never grasped"}


# -- physics exceptions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_physics_exceptions_are_known_and_have_a_reason(name: str) -> None:
    spec = load_end_effector(name)
    assert spec.physics
    for exception in spec.physics:
        assert exception.kind in KINDS
        assert len(exception.reason.split()) > 4


@pytest.mark.parametrize("name", ARMS)
def test_arms_declare_how_they_are_controlled(name: str) -> None:
    assert [e.kind for e in load_arm(name).physics] == ["absolute_joint_control"]


def gripper(spec: EndEffectorSpec):
    from robosuite.models.grippers import GRIPPER_MAPPING

    return GRIPPER_MAPPING[register_gripper(spec)]()


def without(spec: EndEffectorSpec, kind: str) -> EndEffectorSpec:
    changed = [replace(e, enabled=e.enabled and e.kind != kind) for e in spec.physics]
    return replace(spec, name=f"{spec.name}Without", physics=changed)


def mass_kg(spec: EndEffectorSpec) -> float:
    """As MuJoCo compiles it."""
    return float(gripper(spec).get_model().body_subtreemass[0])


def test_masses_of_the_right_fourier_hand_are_a_declared_exception() -> None:
    spec = load_end_effector("FourierRight")
    ours, stock = mass_kg(spec), mass_kg(without(spec, "geom_mass"))
    assert ours < 2.0
    assert stock > 4.0


def test_contacts_within_a_hand_are_a_declared_exception() -> None:
    spec = load_end_effector("RobotiqThreeFinger")
    assert gripper(spec).get_model().nexclude > 20
    assert gripper(without(spec, "no_self_contact")).get_model().nexclude < 20


def test_the_mount_is_a_declared_exception() -> None:
    spec = load_end_effector("Inspire")
    quats = [gripper(s).get_model().body_quat[1] for s in (spec, without(spec, "mount"))]
    np.testing.assert_allclose(quats[0], spec.mount_quat_wxyz, atol=1e-6)
    assert abs(quats[0] @ quats[1]) < 0.99


def test_an_unknown_exception_lists_the_known_ones() -> None:
    spec = load_end_effector("Inspire")
    spec = replace(spec, physics=[*spec.physics, PhysicsException("no_gravity", "because")])
    with pytest.raises(CEIError, match=r"unknown physics exception of Inspire 'no_gravity'.*Valid: mount, "):
        register_gripper(spec)


def test_an_unknown_simulator_name_lists_the_known_ones() -> None:
    spec = replace(load_end_effector("Inspire"), simulator_name="InspireHand")
    with pytest.raises(CEIError, match="unknown simulator_name of Inspire 'InspireHand'"):
        register_gripper(spec)


def test_absolute_control_cannot_be_switched_off_silently() -> None:
    spec = load_end_effector("PandaGripper")
    off = [replace(e, enabled=False) for e in spec.physics]
    with pytest.raises(CEIError, match="must be declared and enabled"):
        register_gripper(replace(spec, physics=off))
