"""The network that denoises actions: LeRobot's UNet, or that of Simple DP3, which has half of its blocks."""

from typing import Any, cast

from lerobot.policies.diffusion.modeling_diffusion import DiffusionConditionalUnet1d
from torch import Tensor, nn

from lerobot_policy_dp3.configuration_dp3 import DP3Config


def make_unet(config: DP3Config, condition_features: int) -> DiffusionConditionalUnet1d:
    """(B, horizon, n) noisy actions, (B,) steps and (B, condition_features) to (B, horizon, n).

    With `residual_blocks=1` each level has one block instead of two, and the middle too, as in Simple DP3.
    """
    unet = DiffusionConditionalUnet1d(cast(Any, config), condition_features)
    if config.residual_blocks == 1:
        for level in (*unet.down_modules, *unet.up_modules):
            cast(nn.ModuleList, level)[1] = Nothing()
        unet.mid_modules = unet.mid_modules[:1]
    return unet


class Nothing(nn.Module):
    """Stands in the place of a block."""

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """x as it is."""
        return x
