"""AdamW in one kernel: on a CPU the loop over a UNet's many small weights takes a tenth of a training step."""

from dataclasses import dataclass

from lerobot.optim import AdamWConfig, OptimizerConfig


@OptimizerConfig.register_subclass("adamw_fused")
@dataclass
class FusedAdamWConfig(AdamWConfig):
    """LeRobot's AdamW, torch's fused one; `fused` is an option of torch's that LeRobot's has not."""

    fused: bool = True
