"""Options of the 3D Diffusion Policy; by default those of its paper and of ours (section V-A)."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature, PreTrainedConfig
from lerobot.optim import DiffuserSchedulerConfig
from lerobot.utils.constants import OBS_STATE

from lerobot_policy_dp3.clouds import CHANNELS, Bounds, layout_of
from lerobot_policy_dp3.optimizer import FusedAdamWConfig

_UNIT = re.compile(r"\.pos_(rad|m)$")


class Size(NamedTuple):
    """Of a UNet: channels of its levels, and residual blocks of each."""

    down_dims: tuple[int, ...]
    residual_blocks: int


SIZES = {
    "paper": Size((512, 1024, 2048), 2),
    "simple": Size((128, 256, 384), 1),
    "small": Size((32, 64, 128), 2),
}
"""DP3, Simple DP3, and one that learns on a CPU in minutes."""


@PreTrainedConfig.register_subclass("dp3")
@dataclass
class DP3Config(PreTrainedConfig):
    """Options of `--policy.type=dp3`.

    Attributes:
        n_obs_steps: observations that an action depends on.
        horizon: actions predicted at once, from the first of those observations on.
        n_action_steps: of these, how many are executed before the next prediction.
        normalization_mapping: how states and actions are normalised; clouds are scaled to their bounds.
        cloud_key: feature with the point cloud, (N, 3) m or, with colours, (N, 6); flat if its dataset says its shape in
            `info.shape`. Other features but the state are ignored.
        cloud_bounds: least and largest value of each channel, which become -1 and 1; None for those of the dataset that is trained on.
        use_colours: look at the colours, too.
        points: how many of the cloud's first points to look at; None for all. In farthest-point order, as CEI-Gym's are, the
            first are as well spread as all.
        random_points: look at as many points chosen at random; in training others each time, acting always the same.
        state_noise: in training, standard deviation of noise on normalised states, one draw for all of a window's observations.
            Joints say which of a few demonstrations it is; a policy that goes by them is lost where none was.
        cloud_channels: of the layers applied to each point; None for DP3's (64, 128, 256), with colours (64, 128, 256, 512).
        cloud_features, state_channels: of the encoders.
        size: of the UNet, one of `SIZES`, unless `down_dims` says it.
        residual_blocks: of each level of the UNet; None for those of `size`, or 2 with `down_dims`.
        down_dims, kernel_size, n_groups, diffusion_step_embed_dim, use_film_scale_modulation, gradient_checkpointing: of the
            UNet; see LeRobot's `DiffusionConfig`.
        num_train_timesteps, num_inference_steps, beta_schedule, prediction_type, clip_sample_range: of the noise (DDIM).
        ema_power, ema_max_decay: at the n-th step the averaged weights decay by `1 - (n - 1) ** -power`, at most by the latter.
            They are the ones that act.
        min_range: joints that move less in the data, rad or m, are normalised as if they moved so much: what never moves in a
            dataset does move a little on a robot.
        action_feature_names: the dataset's, joint by joint, as LeRobot's robots name them (`<joint>.pos`); LeRobot fills it in.
        optimizer_lr, optimizer_betas, optimizer_eps, optimizer_weight_decay, scheduler_warmup_steps: of AdamW, whose rate falls
            by a cosine.
    """

    n_obs_steps: int = 2
    horizon: int = 16
    n_action_steps: int = 8
    normalization_mapping: dict[str, NormalizationMode] = field(
        default_factory=lambda: {"STATE": NormalizationMode.MIN_MAX, "ACTION": NormalizationMode.MIN_MAX}
    )

    cloud_key: str = "observation.point_cloud"
    cloud_bounds: Bounds | None = None
    use_colours: bool = False
    points: int | None = None
    random_points: bool = False
    state_noise: float = 0.0
    cloud_channels: tuple[int, ...] | None = None
    cloud_features: int = 64
    state_channels: tuple[int, int] = (64, 64)

    size: str = "paper"
    down_dims: tuple[int, ...] | None = None
    residual_blocks: int | None = None
    kernel_size: int = 5
    n_groups: int = 8
    diffusion_step_embed_dim: int = 128
    use_film_scale_modulation: bool = True
    gradient_checkpointing: bool = False

    num_train_timesteps: int = 100
    num_inference_steps: int = 10
    beta_schedule: str = "squaredcos_cap_v2"
    prediction_type: Literal["sample", "epsilon"] = "sample"
    clip_sample_range: float = 1.0

    ema_power: float = 0.75
    ema_max_decay: float = 0.9999

    min_range: float = 0.1

    action_feature_names: list[str] | None = None

    optimizer_lr: float = 1e-4
    optimizer_betas: tuple[float, float] = (0.95, 0.999)
    optimizer_eps: float = 1e-8
    optimizer_weight_decay: float = 1e-6
    scheduler_warmup_steps: int = 500

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size not in SIZES:
            raise ValueError(f"unknown policy.size {self.size!r}. Valid: {', '.join(SIZES)}.")
        blocks = 2  # of checkpoints from before Simple DP3's, too
        if self.down_dims is None:
            self.down_dims, blocks = SIZES[self.size]
        if self.residual_blocks is None:
            self.residual_blocks = blocks
        if self.residual_blocks not in (1, 2):
            raise ValueError(f"policy.residual_blocks={self.residual_blocks}. Valid: 1, 2.")
        if self.cloud_channels is None:
            self.cloud_channels = (64, 128, 256, 512) if self.use_colours else (64, 128, 256)
        if self.horizon % (factor := 2 ** (len(self.down_dims) - 1)):
            raise ValueError(f"policy.horizon={self.horizon} is no multiple of {factor}, which down_dims asks for.")
        if self.n_action_steps > (most := self.horizon - self.n_obs_steps + 1):
            raise ValueError(f"policy.n_action_steps={self.n_action_steps} is more than the {most} of the horizon.")
        if self.state_noise < 0:
            raise ValueError(f"policy.state_noise={self.state_noise} is less than 0.")
        if self.prediction_type not in ("sample", "epsilon"):
            raise ValueError(f"unknown policy.prediction_type {self.prediction_type!r}. Valid: sample, epsilon.")

    def set_dataset_feature_metadata(self, features: Mapping[str, dict[str, Any]]) -> None:
        """Learn how clouds lie in the dataset; LeRobot calls this with its features before it makes the policy.

        Raises:
            ValueError: they are flat and nothing says their shape, or they are not what the policy was trained on.
        """
        if self.action_feature_names:
            self.action_feature_names = [_UNIT.sub(".pos", name) for name in self.action_feature_names]
        feature = features.get(self.cloud_key)
        if feature is None or len(feature["shape"]) != 1:
            return
        layout = layout_of(feature)
        if layout is None:
            raise ValueError(
                f"{self.cloud_key!r} is flat, {tuple(feature['shape'])}, and its info.shape does not say (N, 3 or 6)."
            )
        if not self.pretrained_path:
            self.input_features = dict(self.input_features or {})
            self.input_features[self.cloud_key] = PolicyFeature(FeatureType.STATE, layout)
        elif self.cloud_bounds is None:
            raise ValueError(
                f"the policy was trained by an earlier version, on clouds that were not flat as this dataset's {self.cloud_key!r} "
                "is; train anew, or on what it was trained on."
            )
        elif layout[1] != (known := self.cloud_feature.shape)[1]:
            raise ValueError(f"{self.cloud_key!r} has {layout[1]} channels, the policy was trained on {known[1]}.")

    @property
    def cloud_feature(self) -> PolicyFeature:
        """Shape of the point cloud, (N, 3 or 6).

        Raises:
            ValueError: there is none.
        """
        feature = (self.input_features or {}).get(self.cloud_key)
        if feature is None or len(feature.shape) != 2 or feature.shape[1] not in CHANNELS:
            shown = {key: tuple(ft.shape) for key, ft in (self.input_features or {}).items()}
            raise ValueError(f"dp3 needs a point cloud (N, 3 or 6) named {self.cloud_key!r} among the inputs {shown}.")
        return feature

    def validate_features(self) -> None:
        """Check that there are a state, a cloud (with colours where they are wanted) and actions.

        Raises:
            ValueError: saying what is missing.
        """
        if self.robot_state_feature is None:
            raise ValueError(f"dp3 needs {OBS_STATE!r} among the inputs {list(self.input_features or {})}.")
        if self.action_feature is None:
            raise ValueError(f"dp3 needs 'action' among the outputs {list(self.output_features or {})}.")
        points, channels = self.cloud_feature.shape
        if self.cloud_bounds is not None and not _are_bounds(self.cloud_bounds, channels):
            raise ValueError(
                f"policy.cloud_bounds={self.cloud_bounds} should be the least and the largest value of {channels} channels."
            )
        if self.use_colours and channels != 6:
            raise ValueError(
                f"policy.use_colours, but {self.cloud_key!r} is {tuple(self.cloud_feature.shape)}: no colours."
            )
        if self.points is not None and not 1 <= self.points <= points:
            raise ValueError(f"policy.points={self.points}, but the cloud has {points}.")

    def get_optimizer_preset(self) -> FusedAdamWConfig:
        """AdamW as in DP3."""
        return FusedAdamWConfig(
            lr=self.optimizer_lr,
            betas=self.optimizer_betas,
            eps=self.optimizer_eps,
            weight_decay=self.optimizer_weight_decay,
        )

    def get_scheduler_preset(self) -> DiffuserSchedulerConfig:
        """A cosine after a warm-up, as in DP3."""
        return DiffuserSchedulerConfig(name="cosine", num_warmup_steps=self.scheduler_warmup_steps)

    @property
    def drop_n_last_frames(self) -> int:
        """Frames at an episode's end that no window starts at: their actions would be mostly repeats of the last."""
        return self.horizon - self.n_action_steps - self.n_obs_steps + 1

    @property
    def observation_delta_indices(self) -> list[int]:
        """Observations of a window, in frames from now."""
        return list(range(1 - self.n_obs_steps, 1))

    @property
    def action_delta_indices(self) -> list[int]:
        """Actions of a window, in frames from now."""
        return list(range(1 - self.n_obs_steps, 1 - self.n_obs_steps + self.horizon))

    @property
    def reward_delta_indices(self) -> None:
        """No rewards."""
        return None


def _are_bounds(bounds: Bounds, channels: int) -> bool:
    return [len(end) for end in bounds] == [channels] * 2 and all(
        low <= high for low, high in zip(*bounds, strict=True)
    )
