"""`CrossEmbodimentWrapper`: what it shows is what the converter makes, and what it is told the acting robot does."""

import pickle
from pathlib import Path
from typing import Any, ClassVar

import av
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import Embodiment, load_embodiment
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import CloudOptions, RobotMask, SurfaceSampler
from cei_gym.transfer import Transfer
from cei_gym.wrapper import CrossEmbodimentWrapper

PANDA, UR5E = "Panda-PandaGripper", "UR5e-FourierRight"
WORKSPACE = np.array([[0.2, -0.5, 0.0], [0.9, 0.5, 0.6]])
SEEN = 3000  # points of a raw cloud


class Puppet(gym.Env, gym.utils.EzPickle):
    """A robot without physics: its joints are where they are told to be, but for those that something blocks.

    Its cloud is raw: points on the robot, and a ball.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, embodiment: str = UR5E, render_mode: str | None = None) -> None:
        gym.utils.EzPickle.__init__(self, embodiment, render_mode)
        self.embodiment: Embodiment = load_embodiment(embodiment)
        self.render_mode = render_mode
        T = np.eye(4)
        T[:3, 3] = [0.1, -0.05, 0.02]
        self.scene = Scene(T, (), WORKSPACE)
        self.tree = KinematicTree(self.embodiment)
        self.surface = SurfaceSampler(visual_link_meshes(self.embodiment.model), SEEN - 500, seed=5)
        ball = np.random.default_rng(0).normal(size=(500, 3))
        self.ball = 0.03 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0.6, 0.2, 0.1]
        self.blocked: np.ndarray | None = None
        n, box = len(self.embodiment.home), gym.spaces.Box
        self.action_space = box(self.embodiment.lower.astype(np.float32), self.embodiment.upper.astype(np.float32))
        self.observation_space = gym.spaces.Dict(
            {
                "agent_pos": box(-np.inf, np.inf, (n,), np.float32),
                "point_cloud": box(-np.inf, np.inf, (SEEN, 3), np.float32),
            }
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.qpos = np.asarray((options or {}).get("agent_pos", self.embodiment.home), float)
        return self.observe(), {}

    def step(self, action):
        told = np.asarray(action, float)
        self.qpos = told if self.blocked is None else np.where(self.blocked, self.qpos, told)
        return self.observe(), 0.0, False, False, {}

    def render(self):
        return np.zeros((48, 64, 3), np.uint8)

    def observe(self):
        robot = self.surface(self.scene.T_world_base @ self.tree.forward(self.qpos))
        cloud = np.concatenate([robot, self.ball]).astype(np.float32)
        return {"agent_pos": self.qpos.astype(np.float32), "point_cloud": cloud}


gym.register("test/Puppet-v0", Puppet)


@pytest.fixture(scope="module")
def fitted() -> Transfer:
    """From a Panda to a UR5e with a Fourier hand, fitted to a way that no task needs."""
    panda = load_embodiment(PANDA)
    qpos = wander(panda, 10, seed=3)
    transfer = Transfer(panda, load_embodiment(UR5E))
    transfer.fit([Demonstration(PANDA, 20.0, qpos, qpos, Scene(np.eye(4), (), WORKSPACE))])
    return transfer


@pytest.fixture(scope="module")
def actor(fitted: Transfer) -> CrossEmbodimentWrapper:
    """A UR5e with a Fourier hand that plays a Panda."""
    return CrossEmbodimentWrapper(Puppet(), impersonate=fitted)


def near(embodiment: str, points: np.ndarray, qpos: np.ndarray, scene: Scene, tau_m: float) -> np.ndarray:
    robot = load_embodiment(embodiment)
    mask = RobotMask(visual_link_meshes(robot.model), tau_m)
    return mask(points, scene.T_world_base @ KinematicTree(robot).forward(qpos))


def wander(embodiment: Embodiment, steps: int, seed: int = 0) -> np.ndarray:
    """(steps, n) a slow way from home, the hand open."""
    rng = np.random.default_rng(seed)
    direction = rng.uniform(-1, 1, len(embodiment.home)) * (np.arange(len(embodiment.home)) < embodiment.n_arm)
    way = embodiment.home + 0.25 * np.sin(np.linspace(0, 2, steps))[:, None] * direction
    return np.clip(way, embodiment.lower, embodiment.upper)


# -- augment ---------------------------------------------------------------------------------------------------


def test_a_cloud_is_bit_for_bit_the_converters() -> None:
    """Where the robot stands as the converter has it stand."""
    env = Puppet()
    recorded = [env.reset()[0], *(env.step(action)[0] for action in wander(env.embodiment, 4))]
    qpos = np.array([o["agent_pos"] for o in recorded], float)
    clouds = np.stack([o["point_cloud"] for o in recorded])
    demonstration = Demonstration(UR5E, 20.0, qpos, qpos, env.scene, point_cloud_world=clouds)
    converted, _ = Transfer(env.embodiment, env.embodiment)(demonstration)
    assert converted.point_cloud_world is not None
    wrapped = CrossEmbodimentWrapper(env)
    shown = [wrapped.reset(options={"agent_pos": converted.qpos[0]})[0]]
    shown += [wrapped.step(q)[0] for q in converted.qpos[1:]]
    np.testing.assert_array_equal(np.stack([o["agent_pos"] for o in shown]), converted.qpos)
    np.testing.assert_array_equal(np.stack([o["point_cloud"] for o in shown]), converted.point_cloud_world)


def test_colours_are_shown_or_left_out() -> None:
    class Coloured(Puppet):
        def __init__(self):
            super().__init__()
            spaces = dict(self.observation_space.spaces)
            spaces["point_cloud"] = gym.spaces.Box(-np.inf, np.inf, (SEEN, 6), np.float32)
            self.observation_space = gym.spaces.Dict(spaces)

        def observe(self):
            observation = super().observe()
            green = np.tile(np.array([0, 1, 0], np.float32), (SEEN, 1))
            return observation | {"point_cloud": np.concatenate([observation["point_cloud"], green], axis=1)}

    wrapped = CrossEmbodimentWrapper(Coloured())
    cloud = wrapped.reset()[0]["point_cloud"]
    assert wrapped.observation_space["point_cloud"].contains(cloud)
    on_ball = np.abs(np.linalg.norm(cloud[:, :3] - [0.6, 0.2, 0.1], axis=1) - 0.03) < 1e-5
    assert (cloud[on_ball, 3:] == (0, 1, 0)).all()
    assert not (cloud[~on_ball, 3:] == (0, 1, 0)).all(axis=1).any()
    plain = CrossEmbodimentWrapper(Coloured(), clouds=CloudOptions(colours=False))
    np.testing.assert_array_equal(plain.reset()[0]["point_cloud"], cloud[:, :3])
    assert plain.observation_space["point_cloud"].shape == (1024, 3)


def test_the_whole_robot_is_shown_and_the_scene_stays() -> None:
    env = Puppet()
    cloud = CrossEmbodimentWrapper(env).reset()[0]["point_cloud"].astype(float)
    on_robot = near(UR5E, cloud, env.qpos, env.scene, 1e-4)
    on_ball = np.abs(np.linalg.norm(cloud - [0.6, 0.2, 0.1], axis=1) - 0.03) < 1e-5
    assert (on_robot ^ on_ball).all()
    assert on_ball.sum() > 5
    assert on_robot.sum() > 500


def test_spaces_are_declared_and_kept() -> None:
    wrapped = CrossEmbodimentWrapper(Puppet())
    assert wrapped.observation_space["point_cloud"].shape == (1024, 3)
    check_env(wrapped, skip_render_check=True)


@pytest.mark.parametrize("kind", ["empty", "nan", "far"])
def test_clouds_may_hold_anything(kind: str) -> None:
    class Strange(Puppet):
        def observe(self):
            observation = super().observe()
            cloud = observation["point_cloud"]
            if kind == "far":
                cloud += 100
            else:
                cloud[: len(cloud) if kind == "empty" else len(cloud) // 2] = np.nan
            return observation

    env = Strange()
    cloud = CrossEmbodimentWrapper(env).reset()[0]["point_cloud"].astype(float)
    assert np.isfinite(cloud).all()
    on_robot = near(UR5E, cloud, env.qpos, env.scene, 1e-4)
    assert on_robot.all() == (kind != "nan")  # the ball is in the half that was seen


# -- impersonate -----------------------------------------------------------------------------------------------


def test_the_shown_robot_stands_where_the_other_acts(actor: CrossEmbodimentWrapper) -> None:
    observation, _ = actor.reset()
    panda, env = load_embodiment(PANDA), actor.unwrapped
    np.testing.assert_allclose(observation["agent_pos"], panda.home, atol=1e-3)
    cloud = observation["point_cloud"].astype(float)
    ball = np.abs(np.linalg.norm(cloud - [0.6, 0.2, 0.1], axis=1) - 0.03) < 1e-5
    assert near(PANDA, cloud[~ball], observation["agent_pos"], env.scene, 1e-3).all()
    assert actor.action_space.shape == observation["agent_pos"].shape == (9,)
    assert actor.embodiment.name == PANDA


def test_where_the_actor_follows_the_shown_robot_is_where_it_was_told(
    actor: CrossEmbodimentWrapper, fitted: Transfer
) -> None:
    actor.reset()
    env = actor.unwrapped
    for action in wander(load_embodiment(PANDA), 15):
        observation, *_ = actor.step(action)
        np.testing.assert_allclose(observation["agent_pos"], action, atol=2e-3)
        wanted, _ = fitted.place_source(action, np.eye(4))
        pads, _ = fitted.problem.place(env.embodiment.coupled.reduce(env.qpos))
        assert np.linalg.norm(wanted.mean(axis=0) - pads.mean(axis=0)) < 0.02


def test_an_arm_that_is_held_back_shows(actor: CrossEmbodimentWrapper, fitted: Transfer) -> None:
    actor.reset()
    way = wander(load_embodiment(PANDA), 10, seed=1)
    env = actor.unwrapped
    env.blocked = np.ones(len(env.embodiment.home), bool)
    try:
        for action in way:
            shown = actor.step(action)[0]["agent_pos"]
    finally:
        env.blocked = None
    pads, _ = fitted.problem.place(env.embodiment.coupled.reduce(env.qpos))
    told, is_ = (fitted.place_source(q.astype(float), np.eye(4))[0].mean(axis=0) for q in (way[-1], shown))
    assert np.linalg.norm(told - pads.mean(axis=0)) > 0.06
    assert np.linalg.norm(is_ - pads.mean(axis=0)) < 0.02


def test_a_hand_told_to_close_closes_by_steps_and_rests_on_what_it_holds(actor: CrossEmbodimentWrapper) -> None:
    panda, env = load_embodiment(PANDA), actor.unwrapped
    closed = np.concatenate([panda.home[:7], panda.closed[7:]])
    widths = [actor.reset()[0]["agent_pos"][-2]]
    for _ in range(12):
        widths.append(actor.step(closed)[0]["agent_pos"][-2])
    assert widths[0] > 0.035
    assert widths[-1] < 0.01
    assert (np.diff(widths) < 0.012).all()
    actor.reset()
    for _ in range(3):
        held = actor.step(closed)[0]["agent_pos"][-2]
    hand = np.arange(len(env.embodiment.home)) >= env.embodiment.n_arm
    env.blocked = hand
    try:
        for _ in range(6):
            still = actor.step(closed)[0]["agent_pos"][-2]
    finally:
        env.blocked = None
    assert abs(still - held) < 0.004
    opened = actor.step(panda.home)[0]["agent_pos"][-2]
    assert opened > held


def test_a_start_of_the_shown_robot_can_be_asked_for(actor: CrossEmbodimentWrapper) -> None:
    start = wander(load_embodiment(PANDA), 5, seed=2)[-1]
    observation, _ = actor.reset(options={"agent_pos": start})
    np.testing.assert_allclose(observation["agent_pos"], start, atol=1e-3)


def test_without_a_start_option_the_shown_robot_comes_to_where_the_actor_is(fitted: Transfer) -> None:
    actor = CrossEmbodimentWrapper(Puppet(), impersonate=fitted, start_option=None)
    observation, _ = actor.reset()
    env = actor.unwrapped
    np.testing.assert_array_equal(env.qpos, env.embodiment.home)
    shown, _ = fitted.place_source(observation["agent_pos"].astype(float), np.eye(4))
    pads, _ = fitted.problem.place(env.embodiment.coupled.reduce(env.qpos))
    assert np.linalg.norm(shown.mean(axis=0) - pads.mean(axis=0)) < 0.02
    before = env.qpos.copy()
    actor.step(observation["agent_pos"])  # to stay
    assert np.abs(env.qpos - before)[: env.embodiment.n_arm].max() < 0.2


# -- as a wrapper among others -----------------------------------------------------------------------------------


@pytest.mark.parametrize("impersonates", [False, True])
def test_it_pickles_and_can_be_made_again_from_its_spec(impersonates: bool, fitted: Transfer) -> None:
    wrapped = CrossEmbodimentWrapper(gym.make("test/Puppet-v0"), impersonate=fitted if impersonates else None)
    first, _ = wrapped.reset()
    for again in (pickle.loads(pickle.dumps(wrapped)), gym.make(wrapped.spec)):
        np.testing.assert_array_equal(again.reset()[0]["point_cloud"], first["point_cloud"])


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_it_composes_with_vector_environments(mode: str) -> None:
    envs = gym.make_vec("test/Puppet-v0", 2, vectorization_mode=mode, wrappers=[CrossEmbodimentWrapper])
    observation, _ = envs.reset()
    assert observation["point_cloud"].shape == (2, 1024, 3)
    np.testing.assert_array_equal(observation["point_cloud"][0], observation["point_cloud"][1])
    envs.close()


def test_record_video_records_it(tmp_path: Path) -> None:
    env = CrossEmbodimentWrapper(gym.make("test/Puppet-v0", render_mode="rgb_array", max_episode_steps=3))
    env = gym.wrappers.RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: True)
    env.reset()
    for _ in range(3):
        env.step(env.unwrapped.embodiment.home.astype(np.float32))
    env.close()
    with av.open(str(tmp_path / "rl-video-episode-0.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) >= 3


def test_it_composes_with_gymnasiums_wrappers() -> None:
    env = CrossEmbodimentWrapper(gym.make("test/Puppet-v0", render_mode="rgb_array", max_episode_steps=3))
    env = gym.wrappers.FrameStackObservation(gym.wrappers.RenderCollection(env), 2)
    observation, _ = env.reset()
    assert observation["point_cloud"].shape == (2, 1024, 3)
    for truncates in (False, False, True):
        *_, truncated, _ = env.step(env.unwrapped.embodiment.home.astype(np.float32))
        assert truncated == truncates
    assert len(env.render()) == 4
    env.close()


# -- bad input ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"cloud_key": "cloud"}, r"have no 'cloud'. They have: agent_pos, point_cloud\."),
        ({"embodiment": PANDA}, r"Panda-PandaGripper has 9 joints, but observed joints of .* have shape"),
        ({"embodiment": "UR5"}, "Did you mean 'UR5e'"),
    ],
)
def test_bad_arguments_are_named(arguments: dict, message: str) -> None:
    with pytest.raises(CEIError, match=message):
        CrossEmbodimentWrapper(Puppet(), **arguments)


def test_an_environment_that_says_nothing_of_its_robot_is_named() -> None:
    env = gym.make("Pendulum-v1")
    with pytest.raises(CEIError, match="no attribute 'embodiment'; give it to the wrapper"):
        CrossEmbodimentWrapper(env)


def test_a_transfer_that_does_not_fit_is_named(fitted: Transfer) -> None:
    with pytest.raises(CEIError, match=r"how UR5e-FourierRight starts .* call the transfer's `fit`"):
        CrossEmbodimentWrapper(Puppet(), impersonate=Transfer(fitted.source, fitted.target))
    with pytest.raises(CEIError, match="to UR5e-FourierRight, but IIWA-Inspire acts"):
        CrossEmbodimentWrapper(Puppet("IIWA-Inspire"), impersonate=fitted)


def test_a_wrong_action_is_named(actor: CrossEmbodimentWrapper) -> None:
    actor.reset()
    with pytest.raises(CEIError, match="takes 9 finite joint positions"):
        actor.step(np.zeros(12))
    with pytest.raises(CEIError, match="takes 9 finite joint positions"):
        actor.reset(options={"agent_pos": [0.0]})
