"""3D Diffusion Policy: LeRobot's diffusion over actions, conditioned on point clouds and states."""

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import torch
import torch.nn.functional as F
from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from lerobot.policies.diffusion.modeling_diffusion import DiffusionModel
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.utils import populate_queues
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor, nn

from lerobot_policy_dp3.averaging import averaged
from lerobot_policy_dp3.clouds import bounds_of
from lerobot_policy_dp3.configuration_dp3 import DP3Config
from lerobot_policy_dp3.encoder import ObservationEncoder
from lerobot_policy_dp3.unet import make_unet

FLAT = 1e-4
"""A channel that spans less in the data is centred, not stretched, as in DP3."""


class DP3Policy(PreTrainedPolicy):
    """See `DP3Config`. Weights are trained, and their running average acts; checkpoints hold both."""

    config_class = DP3Config  # pyright: ignore[reportAssignmentType]
    """LeRobot's: the options of this policy."""
    name = "dp3"  # pyright: ignore[reportAssignmentType]
    """LeRobot's: what `--policy.type` calls it."""

    def __init__(
        self,
        config: DP3Config,
        dataset_stats: Mapping[str, Any] | None = None,
        dataset_meta: Any | None = None,
        **kwargs,
    ) -> None:
        """
        Args:
            config: see there; its `cloud_bounds` become those of the dataset, if it is new and has none.
            dataset_stats: of the dataset that it is to be trained on.
            dataset_meta: its metadata, a `LeRobotDatasetMetadata`.
            kwargs: what else LeRobot gives to policies.
        """
        super().__init__(config)
        config.validate_features()
        if config.cloud_bounds is None and not config.pretrained_path:
            root = None if dataset_meta is None else Path(dataset_meta.root)
            config.cloud_bounds = bounds_of(config.cloud_key, config.cloud_feature.shape[1], dataset_stats, root)
            if config.cloud_bounds is None and root is not None:
                raise ValueError(
                    f"{root} has neither statistics of {config.cloud_key!r} nor tables to make them from; give --policy.cloud_bounds."
                )
        self.config: DP3Config = config
        self.model = DP3Model(config)
        self.average = averaged(self.model, config.ema_power, config.ema_max_decay)
        self.reset()

    def get_optim_params(self):
        """What the optimiser changes; the average follows by itself."""
        return self.model.parameters()

    def update(self) -> None:
        """Move the average; LeRobot calls this after each optimiser step."""
        self.average.update_parameters(self.model)

    def reset(self) -> None:
        """Forget past observations and actions still to be executed."""
        observed = {key: deque(maxlen=self.config.n_obs_steps) for key in (OBS_STATE, self.config.cloud_key)}
        self._queues = {**observed, ACTION: deque(maxlen=self.config.n_action_steps)}

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor], noise: Tensor | None = None) -> Tensor:
        """(B, n_action_steps, n) normalised actions from the last observations, or from a batch of windows.

        Args:
            batch: normalised observations; used only where `select_action` has not collected any. Single ones (B, ...), as LeRobot's
                server gives them, stand for those before, too.
            noise: (B, horizon, n) what the diffusion starts from; random if None.
        """
        if all(self._queues[key] for key in (OBS_STATE, self.config.cloud_key)):
            batch = {key: torch.stack(list(queue), dim=1) for key, queue in self._queues.items() if key != ACTION}
        elif batch[OBS_STATE].ndim == 2:
            alone = {key: batch[key] for key in (OBS_STATE, self.config.cloud_key)}
            batch = {key: torch.stack([value] * self.config.n_obs_steps, dim=1) for key, value in alone.items()}
        return self._acting.generate_actions(batch, noise=noise)

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor], noise: Tensor | None = None) -> Tensor:
        """(B, n) the next normalised action, for one normalised observation each, (B, ...)."""
        batch = {key: value for key, value in batch.items() if key != ACTION}
        self._queues = populate_queues(self._queues, batch)
        if not self._queues[ACTION]:
            self._queues[ACTION].extend(self.predict_action_chunk(batch, noise).transpose(0, 1))
        return self._queues[ACTION].popleft()

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, None]:
        """The loss of a batch of windows; nothing else to log."""
        # Noise of its own for each step: LeRobot's data loader draws from the global generator too, but not when it resumes.
        random = torch.Generator(batch[ACTION].device)
        random.manual_seed((torch.initial_seed() + int(self.average.n_averaged)) % 2**63)
        batch = {**batch, self.config.cloud_key: self.model.clouds(batch)}
        return self.model.compute_loss(self._perturbed(batch, random) if self.training else batch, random), None

    def _perturbed(self, batch: dict[str, Tensor], random: torch.Generator) -> dict[str, Tensor]:
        """What training makes of a batch; see `DP3Config.random_points` and `state_noise`."""
        config, state, cloud = self.config, batch[OBS_STATE], batch[self.config.cloud_key]
        if config.random_points:
            chosen = torch.randperm(cloud.shape[-2], generator=random, device=cloud.device)[: config.points]
            cloud = cloud[..., chosen, :]
        if config.state_noise:
            noise = torch.randn(state[:, :1].shape, generator=random, device=state.device, dtype=state.dtype)
            state = state + config.state_noise * noise
        return {**batch, OBS_STATE: state, config.cloud_key: cloud}

    @property
    def _acting(self) -> "DP3Model":
        return cast(DP3Model, self.average.module) if self.average.n_averaged else self.model


class DP3Model(DiffusionModel):
    """Denoises actions given the encoded observations; sampling is LeRobot's."""

    def __init__(self, config: DP3Config) -> None:
        nn.Module.__init__(self)  # LeRobot's own would build an encoder of pictures
        assert config.robot_state_feature is not None and config.cloud_channels is not None
        self.config = config
        self.obs_encoder = ObservationEncoder(
            self._channels,
            config.cloud_channels,
            config.cloud_features,
            config.robot_state_feature.shape[0],
            config.state_channels,
        )
        self.unet = make_unet(config, self.obs_encoder.out_features * config.n_obs_steps)
        low, high = torch.tensor(config.cloud_bounds or [[-1.0] * 6, [1.0] * 6])[:, : self._channels]
        flat = high - low < FLAT
        scale = torch.where(flat, 1.0, 2 / (high - low))
        # not in checkpoints, whose configuration has the bounds
        self.register_buffer("cloud_scale", scale, persistent=False)
        self.register_buffer("cloud_offset", torch.where(flat, -low, -1 - scale * low), persistent=False)
        self.noise_scheduler = DDIMScheduler(
            num_train_timesteps=config.num_train_timesteps,
            beta_schedule=config.beta_schedule,
            clip_sample=True,
            clip_sample_range=config.clip_sample_range,
            prediction_type=config.prediction_type,
        )
        self.num_inference_steps = config.num_inference_steps

    def compute_loss(self, batch: dict[str, Tensor], random: torch.Generator | None = None) -> Tensor:
        """Mean squared error of the denoised actions, or of the noise.

        Args:
            batch: normalised state (B, n_obs_steps, n) and actions (B, horizon, n), cloud (B, n_obs_steps, N, C) as it is.
            random: of the noise; the global generator if None.
        """
        condition, actions = self._prepare_global_conditioning(batch), batch[ACTION]
        noise = torch.randn(actions.shape, generator=random, device=actions.device, dtype=actions.dtype)
        most = self.config.num_train_timesteps
        steps = torch.randint(0, most, (len(actions),), generator=random, device=actions.device)
        noisy = self.noise_scheduler.add_noise(actions, noise, cast(Any, steps))
        predicted = self.unet(noisy, steps, global_cond=condition)
        return F.mse_loss(predicted, actions if self.config.prediction_type == "sample" else noise)

    def clouds(self, batch: dict[str, Tensor]) -> Tensor:
        """(B, n_obs_steps, N, C) those of a batch, which may be flat."""
        cloud = batch[self.config.cloud_key]
        return cloud if cloud.ndim == 4 else cloud.unflatten(-1, (-1, self.config.cloud_feature.shape[1]))

    @property
    def _channels(self) -> int:
        """How many numbers of a point are looked at."""
        return 6 if self.config.use_colours else 3

    def _looked_at(self, count: int) -> Tensor | slice:
        """Which of so many points: those that `DP3Policy` put first in training; of a policy that has learnt from points chosen at random also
        some, always the same, chosen at random. The first of a cloud in farthest-point order are spread otherwise than any that it has seen."""
        if self.config.random_points and not self.training:
            return torch.randperm(count, generator=torch.Generator().manual_seed(0))[: self.config.points]
        return slice(self.config.points)

    def _prepare_global_conditioning(self, batch: dict[str, Tensor]) -> Tensor:
        """(B, n_obs_steps * features)."""
        state, cloud = batch[OBS_STATE], self.clouds(batch)
        cloud = cloud[..., self._looked_at(cloud.shape[-2]), : self._channels]
        cloud = cloud * cast(Tensor, self.cloud_scale) + cast(Tensor, self.cloud_offset)
        return self.obs_encoder(cloud.flatten(0, 1), state.flatten(0, 1)).reshape(len(state), -1)
