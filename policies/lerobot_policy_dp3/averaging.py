"""Running average of weights (EMA), part of the policy so that checkpoints hold it."""

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel


def averaged(model: nn.Module, power: float, max_decay: float) -> AveragedModel:
    """A frozen copy of a model that follows it by `update_parameters`; its first two updates copy.

    Args:
        model: what to average.
        power: after n updates, from the second on, the average decays by `1 - n ** -power`,
        max_decay: but by no more than this.
    """
    average = AveragedModel(model, multi_avg_fn=partial(_follow, power, max_decay))
    return average.requires_grad_(False)


@torch.no_grad()
def _follow(
    power: float, max_decay: float, average: Sequence[Tensor], model: Sequence[Tensor], updates: Tensor | int
) -> None:
    decay = min(max_decay, 1 - float(updates) ** -power)  # the first update is not this function's
    for mean, new in zip(average, model, strict=True):
        mean.lerp_(new, 1 - decay)
