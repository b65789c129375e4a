"""The environments as a LeRobot plugin: `--env.type=cei`."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType
from lerobot.envs import make_env, make_env_config
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.converters import policy_action_to_transition, transition_to_policy_action
from lerobot.scripts.lerobot_eval import eval_policy
from lerobot.utils.constants import ACTION

from cei_converters.simulation.rollout import record_episode
from cei_envs.rollout import NEW_ROLLOUT, OneEpisode, make_rollout_env
from cei_gym.errors import CEIError
from cei_gym.pointcloud import CloudOptions
from cei_gym.wrapper import CrossEmbodimentWrapper
from lerobot_env_cei import CEIEnvConfig
from lerobot_policy_dp3 import DP3Config

PANDA = "PickCube-Panda-PandaGripper"
FAST = {"render": False, "episode_length": 3}


class Recorded(PreTrainedPolicy):
    """Repeats recorded actions, one recording a sub-environment."""

    config_class, name = DP3Config, "recorded"

    def __init__(self, actions: list[np.ndarray]) -> None:
        torch.nn.Module.__init__(self)
        self.actions, self.step = actions, 0

    def reset(self) -> None:
        self.step = 0

    def select_action(self, batch, **kwargs):
        self.step += 1
        return torch.tensor(np.stack([a[min(self.step, len(a)) - 1] for a in self.actions]))

    def get_optim_params(self):
        raise NotImplementedError

    predict_action_chunk = forward = get_optim_params


@pytest.mark.parametrize("asynchronous", [False, True])
def test_success_is_what_the_environment_reports_and_the_finished_stand_still(asynchronous):
    recorder = gym.make(f"CEI-{PANDA}")
    recordings = [record_episode(recorder, seed, seed)[0] for seed in (3, 4)]
    recorder.close()
    config = make_env_config("cei", task=PANDA, augment=False, render=False, episode_length=150)
    vector = make_env(config, n_envs=2, use_async_envs=asynchronous)["cei"][0]
    blind = np.repeat(recordings[0].qpos[:1], 2, axis=0)  # stays where it is
    policy = Recorded([recordings[0].action, blind])
    unchanged: PolicyProcessorPipeline = PolicyProcessorPipeline(steps=[])
    actions: PolicyProcessorPipeline = PolicyProcessorPipeline(
        steps=[], to_transition=policy_action_to_transition, to_output=transition_to_policy_action
    )
    result = eval_policy(vector, policy, unchanged, unchanged, unchanged, actions, n_episodes=2, start_seed=3)
    assert [episode["success"] for episode in result["per_episode"]] == [True, False]
    assert [episode["sum_reward"] for episode in result["per_episode"]] == [1.0, 0.0]
    assert result["per_episode"][0]["seed"] == 3
    vector.close()


def test_an_episode_stands_still_after_its_end_until_a_new_one_is_asked_for():
    class Counting(gym.Env):
        observation_space, action_space = gym.spaces.Discrete(100), gym.spaces.Discrete(2)
        steps = 0

        def reset(self, *, seed=None, options=None):
            assert NEW_ROLLOUT not in (options or {})
            self.steps = 0
            return 0, {}

        def step(self, action):
            self.steps += 1
            return self.steps, 2.0, self.steps == 3, False, {"is_success": self.steps == 3}

    env = OneEpisode(gym.wrappers.TimeLimit(Counting(), 10))
    env.reset(seed=0, options={NEW_ROLLOUT: True})
    rewards = [env.step(0)[1] for _ in range(6)]
    assert rewards == [2.0, 2.0, 2.0, 0.0, 0.0, 0.0]
    assert env.reset() == (3, {"is_success": True})
    assert env.step(0)[2:] == (True, False, {"is_success": True})
    assert env.unwrapped.steps == 3
    assert env.reset(options={NEW_ROLLOUT: True}) == (0, {})
    assert env.step(0)[0] == 1


def test_clouds_are_the_wrappers_unless_switched_off():
    plain = gym.make(f"CEI-{PANDA}")
    wrapped = CrossEmbodimentWrapper(gym.make(f"CEI-{PANDA}"), clouds=CloudOptions(points=100))
    for options, env in (({"clouds": CloudOptions(points=100)}, wrapped), ({"augment": False}, plain)):
        config = CEIEnvConfig(task=f"CEI-{PANDA}", **FAST, **options)
        vector = config.create_envs(1)["cei"][0]
        shown, _ = vector.reset(seed=[7], options={NEW_ROLLOUT: True})
        expected, _ = env.reset(seed=7)
        np.testing.assert_array_equal(shown["point_cloud"][0], expected["point_cloud"])
        for key in ("agent_pos", "point_cloud", "environment_state"):
            assert config.features[key].shape == shown[key].shape[1:]
        assert config.features[ACTION].shape == vector.single_action_space.shape
        vector.close()


def test_options_reach_the_environment():
    config = CEIEnvConfig(
        task="StackCube-IIWA-Inspire", cameras=["front", "left"], depth_noise="kinect", colours=True, **FAST
    )
    assert config.features["point_cloud"].shape == (1024, 6)
    assert config.features["environment_state"].type is FeatureType.ENV
    vector = config.create_envs(1)["cei"][0]
    env = vector.envs[0]
    assert [camera.name for camera in env.get_wrapper_attr("scene").cameras] == ["front", "left"]
    assert vector.call("_max_episode_steps") == (3,)
    assert vector.call("task_description")[0] == env.get_wrapper_attr("task_text")
    vector.reset(seed=[0])
    ends = [vector.step(np.stack([env.get_wrapper_attr("embodiment").home])) for _ in range(3)]
    assert [bool(end[3][0]) for end in ends] == [False, False, True]
    vector.close()


def test_pictures_for_videos():
    env = make_rollout_env(f"CEI-{PANDA}", None, clouds=False, render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (240, 320, 3)
    assert picture.dtype == np.uint8
    env.close()


def test_an_unknown_task_gets_the_valid_ones():
    with pytest.raises(CEIError, match=r"PickCube-UR5e-FourierRigth.*Did you mean .*PickCube-UR5e-FourierRight"):
        CEIEnvConfig(task="PickCube-UR5e-FourierRigth")


def test_workers_need_no_lerobot():
    code = "import sys, cei_envs.rollout, cei_envs.environment; print([m for m in ('lerobot', 'torch') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
