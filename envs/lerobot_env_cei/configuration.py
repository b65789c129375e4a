"""Options of the environments, and their vector form."""

import logging
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

import draccus
from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig
from lerobot.processor import PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE, OBS_STR

from cei_converters.dataset.essentials import Remains
from cei_converters.dataset.locate import locate, locate_metadata, read_info
from cei_converters.dataset.metadata import METADATA_PATH, START, Metadata, restore_with
from cei_converters.dataset.opening import find_metadata, has_flat_clouds
from cei_converters.dataset.starts import find_starts
from cei_converters.simulation.environment import check_arguments
from cei_envs import environment_id, environment_ids
from cei_envs.environment import CAMERAS, CLOUD_POINTS, IMAGE_HEIGHT, IMAGE_WIDTH, CEIEnv
from cei_envs.registration import tasks
from cei_envs.rollout import make_rollout_env
from cei_envs.simulation import CONTROL_HZ
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError, unknown
from cei_gym.pointcloud import CloudOptions
from cei_gym.wrapper import PIXELS
from lerobot_env_cei.processors import FlatClouds
from lerobot_env_cei.workers import quick_start

_OPTIONS = {
    **{name: name for name in ("cameras", "depth_noise", "colours", "pixels", "disable_env_checker")},
    "max_episode_steps": "episode_length",
    "render_mode": "render",
}
"""Arguments of environments that have options of their own."""


@EnvConfig.register_subclass("cei")
@dataclass
class CEIEnvConfig(EnvConfig):
    """Options of `--env.type=cei`.

    Attributes:
        dataset: of the policy's demonstrations, a folder or a repo id: episodes are as there, from the task to where the robot
            starts, its cameras and the options of its clouds, unless options say otherwise.
        task: `<Task>-<Arm>-<EndEffector>`, with or without `CEI-` in front; without a dataset, robots start at home.
        fps: steps a second, as LeRobot asks for.
        augment: show policies the clouds that `cei-convert` makes (`CrossEmbodimentWrapper`), not those of the cameras; None
            for yes, unless the dataset is no converted one.
        clouds: options of these clouds, as those of `cei-convert`; None for the dataset's, else the default.
        cameras, depth_noise, colours: see `cei_envs.environment.CEIEnv`.
        pixels: show policies what the environment's cameras see, `observation.images.<camera>`; None for yes, if the dataset has pictures of one of them.
        paint: paint the robot over itself in them, as in the pictures of a painted dataset; None for yes, if the dataset says that it is painted.
        arguments: others of the task's environment, by name, JSON such as {"middle_m": [0.0, 0.2]}; they win over the dataset's.
        episode_length: most steps of an episode.
        render: pictures for videos.
        features_map: entry of an observation, or `action`, to the name that policies know it by.
    """

    dataset: str | None = None
    task: str | None = None
    fps: int = CONTROL_HZ
    augment: bool | None = None
    clouds: CloudOptions | None = None
    cameras: list[str] | None = None
    depth_noise: str | None = None
    colours: bool | None = None
    pixels: bool | None = None
    paint: bool | None = None
    arguments: dict[str, Any] = field(default_factory=dict[str, Any])
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
        found = (None, False, set[str]()) if self.dataset is None else _read(self.dataset)
        recorded, self._flat_clouds, pictured = found
        self.task = _checked_task(self.task, recorded, self.dataset)
        if recorded is None:
            logging.warning(
                "%s starts with the robot at home; a policy that was trained on converted demonstrations wants "
                "--env.dataset=<their folder or repo id>, to start where they do.",
                self.task,
            )
        if self.augment is None:
            self.augment = recorded is None or recorded.clouds is not None
        self._recorded = {} if recorded is None else recorded.environment.kwargs
        check_arguments(self.gym_id, self._recorded)
        for name, option in _OPTIONS.items():
            if name in self.arguments:
                raise CEIError(f"--env.arguments has {name}, which --env.{option} is for.")
        check_arguments(self.gym_id, self.arguments)
        self._augmentation = self.clouds or _recorded_clouds(recorded)
        task, name = _task_and_robot(self.task)
        entry = cast(type[CEIEnv], load_env_creator(tasks()[task].environment))
        kwargs = self.gym_kwargs
        cameras = kwargs.get("cameras", CAMERAS)
        if self.pixels is None:
            self.pixels = not pictured.isdisjoint(cameras)
        if self.paint is None:
            self.paint = self.pixels and self.augment and recorded is not None and recorded.is_painted
        if self.paint and not (self.pixels and self.augment):
            raise CEIError(
                "--env.paint paints what --env.pixels shows, with --env.augment: turn both on, or leave it out."
            )
        n = len(load_embodiment(name).home)
        points = self._augmentation.points if self.augment else CLOUD_POINTS
        coloured = kwargs.get("colours") and (self._augmentation.colours or not self.augment)
        self.features = {
            ACTION: PolicyFeature(FeatureType.ACTION, (n,)),
            "agent_pos": PolicyFeature(FeatureType.STATE, (n,)),
            "point_cloud": PolicyFeature(FeatureType.STATE, (points, 6 if coloured else 3)),
            "environment_state": PolicyFeature(FeatureType.ENV, (len(entry.state_names),)),
        }
        for camera in cameras if self.pixels else ():
            size = kwargs.get("image_height", IMAGE_HEIGHT), kwargs.get("image_width", IMAGE_WIDTH), 3
            self.features[f"{PIXELS}/{camera}"] = PolicyFeature(FeatureType.VISUAL, size)
            self.features_map.setdefault(f"{PIXELS}/{camera}", f"{OBS_IMAGES}.{camera}")

    @property
    def gym_id(self) -> str:
        """The name of the environment, for Gymnasium."""
        return environment_id(*_task_and_robot(str(self.task)))

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """What `gym.make` gets."""
        given = {"cameras": self.cameras, "depth_noise": self.depth_noise, "colours": self.colours}
        return {
            **self._recorded,
            **self.arguments,
            **{name: value for name, value in given.items() if value is not None},
            "max_episode_steps": self.episode_length,
            "render_mode": "rgb_array" if self.render else None,
            "disable_env_checker": self.disable_env_checker,
            **({"pixels": True} if self.pixels else {}),
        }

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, VectorEnv]]:
        """One vector environment of `n_envs`, in processes of their own or one after the other."""
        clouds, paint = self._augmentation if self.augment else None, bool(self.paint)
        make = partial(make_rollout_env, self.gym_id, clouds, paint, **self.gym_kwargs)
        makers = [make] * n_envs
        # The environments repeat their last step by themselves; a reset in the same step would cost a simulation.
        if not (use_async_envs and n_envs > 1):
            return {self.type: {0: SyncVectorEnv(makers, autoreset_mode=AutoresetMode.NEXT_STEP)}}
        with quick_start():
            vector = AsyncVectorEnv(makers, context="forkserver", autoreset_mode=AutoresetMode.NEXT_STEP)
        return {self.type: {0: vector}}

    def get_env_processors(self) -> tuple[PolicyProcessorPipeline, PolicyProcessorPipeline]:
        """The steps between environment and policy, and back: clouds lie as in the dataset, flat or not."""
        steps = [FlatClouds()] if self._flat_clouds else []
        return PolicyProcessorPipeline(steps=steps), PolicyProcessorPipeline(steps=[])


def _read(dataset: str) -> tuple[Metadata, bool, set[str]]:
    """What is known of a dataset, where it starts as its own frames say if it was edited; whether its clouds are flat; of which cameras it has
    pictures."""
    root = locate_metadata(dataset)
    metadata = find_metadata(root)
    if metadata is None:
        raise CEIError(f"{dataset} is no dataset of CEI-Gym: {METADATA_PATH} is missing. {restore_with(root)}")
    flat = has_flat_clouds(root)
    prefix = f"{OBS_IMAGES}."
    pictured = {key.removeprefix(prefix) for key in read_info(root)["features"] if key.startswith(prefix)}
    if not isinstance(metadata, Remains) or metadata.clouds is None:
        return metadata, flat, pictured
    starts = find_starts(root if (root / "data").is_dir() else locate(dataset, None))
    environment = replace(metadata.environment, kwargs=metadata.environment.kwargs | {START: starts})
    return replace(metadata, environment=environment), flat, pictured


def _checked_task(task: str | None, recorded: Metadata | None, dataset: str | None) -> str:
    """`<Task>-<Arm>-<EndEffector>`, as given or as recorded."""
    known = [env_id.removeprefix("CEI-") for env_id in environment_ids()]
    given = None if task is None else task.removeprefix("CEI-")
    if given is not None and given not in known:
        raise unknown("env.task", given, known)
    if recorded is None:
        if given is None:
            raise CEIError(
                "give --env.dataset, what the policy was trained on, or --env.task=<Task>-<Arm>-<EndEffector>."
            )
        return given
    theirs = str(recorded.environment.id).removeprefix("CEI-")
    if theirs not in known:
        raise CEIError(f"dataset {dataset} names no environment of CEI-Gym ({theirs}); give --env.task instead.")
    if given not in (None, theirs):
        raise CEIError(f"--env.task={given}, but dataset {dataset} is of {theirs}; give one of the two.")
    return theirs


def _task_and_robot(name: str) -> tuple[str, str]:
    """`<Task>` and `<Arm>-<EndEffector>`; a task may have hyphens."""
    task, arm, end_effector = name.rsplit("-", 2)
    return task, f"{arm}-{end_effector}"


def _recorded_clouds(recorded: Metadata | None) -> CloudOptions:
    return draccus.decode(CloudOptions, {} if recorded is None else recorded.clouds or {})
