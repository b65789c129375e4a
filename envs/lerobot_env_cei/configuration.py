"""Options of the environments, and their vector form."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any, cast

from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE, OBS_STR

from cei_envs import environment_id, environment_ids
from cei_envs.environment import CLOUD_POINTS, CEIEnv
from cei_envs.registration import TASKS
from cei_envs.rollout import make_rollout_env
from cei_envs.simulation import CONTROL_HZ
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import unknown
from cei_gym.pointcloud import CloudOptions
from lerobot_env_cei.workers import quick_start


@EnvConfig.register_subclass("cei")
@dataclass
class CEIEnvConfig(EnvConfig):
    """Options of `--env.type=cei`.

    Attributes:
        task: `<Task>-<Arm>-<EndEffector>`, with or without `CEI-` in front.
        augment: show policies the clouds that `cei-convert` makes (`CrossEmbodimentWrapper`), not those of the cameras.
        clouds: options of these clouds, as those of `cei-convert`.
        cameras, depth_noise, colours: see `cei_envs.environment.CEIEnv`.
        episode_length: most steps of an episode.
        render: pictures for videos.
    """

    task: str | None = "PickCube-Panda-PandaGripper"
    fps: int = CONTROL_HZ
    augment: bool = True
    clouds: CloudOptions = field(default_factory=CloudOptions)
    cameras: list[str] = field(default_factory=lambda: ["front"])
    depth_noise: str | None = None
    colours: bool = False
    episode_length: int = 400
    render: bool = True
    features_map: dict[str, str] = field(
        default_factory=lambda: {
            ACTION: ACTION,
            "agent_pos": OBS_STATE,
            "point_cloud": f"{OBS_STR}.point_cloud",
            "environment_state": OBS_ENV_STATE,
        }
    )

    def __post_init__(self) -> None:
        known = [env_id.removeprefix("CEI-") for env_id in environment_ids()]
        self.task = (self.task or "").removeprefix("CEI-")
        if self.task not in known:
            raise unknown("env.task", self.task, known)
        task, name = self.task.split("-", 1)
        entry = cast(type[CEIEnv], load_env_creator(TASKS[task][0]))
        n = len(load_embodiment(name).home)
        points = self.clouds.points if self.augment else CLOUD_POINTS
        coloured = self.colours and (self.clouds.colours or not self.augment)
        self.features = {
            ACTION: PolicyFeature(FeatureType.ACTION, (n,)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (n,)),
            "point_cloud": PolicyFeature(FeatureType.STATE, (points, 6 if coloured else 3)),
            "environment_state": PolicyFeature(FeatureType.ENV, (len(entry.state_names),)),
        }

    @property
    def gym_id(self) -> str:
        """Of the environment."""
        return environment_id(*str(self.task).split("-", 1))

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """What `gym.make` gets."""
        return {
            "cameras": tuple(self.cameras),
            "depth_noise": self.depth_noise,
            "colours": self.colours,
            "max_episode_steps": self.episode_length,
            "render_mode": "rgb_array" if self.render else None,
            "disable_env_checker": self.disable_env_checker,
        }

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, VectorEnv]]:
        """One vector environment of `n_envs`, in processes of their own or one after the other."""
        make = partial(make_rollout_env, self.gym_id, self.clouds if self.augment else None, **self.gym_kwargs)
        makers = [make] * n_envs
        # The environments repeat their last step by themselves; a reset in the same step would cost a simulation.
        if not (use_async_envs and n_envs > 1):
            return {self.type: {0: SyncVectorEnv(makers, autoreset_mode=AutoresetMode.NEXT_STEP)}}
        with quick_start():
            vector = AsyncVectorEnv(makers, context="forkserver", autoreset_mode=AutoresetMode.NEXT_STEP)
        return {self.type: {0: vector}}
