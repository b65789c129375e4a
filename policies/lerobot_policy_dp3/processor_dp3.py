"""Before and after the policy: LeRobot's default steps, with statistics that suit a robot at work."""

from typing import Any

import torch
from lerobot.processor import PolicyAction, PolicyProcessorPipeline, make_default_pre_post_processors
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_policy_dp3.configuration_dp3 import DP3Config


def make_dp3_pre_post_processors(
    config: DP3Config, dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]:
    """The steps before the policy (normalise) and after it (back to rad and m); see `DP3Config.min_range`."""
    stats = dict(dataset_stats or {})
    for key in {OBS_STATE, ACTION} & set(stats):
        stats[key] = _widened(stats[key], config.min_range)
    return make_default_pre_post_processors(config, stats or None)


def _widened(stats: dict[str, Any], least: float) -> dict[str, Any]:
    """Statistics whose max and min lie `least` apart at least, about the same middle."""
    low, high = (torch.as_tensor(stats[name]) for name in ("min", "max"))
    middle, half = (low + high) / 2, ((high - low) / 2).clamp(min=least / 2)
    return {**stats, "min": middle - half, "max": middle + half}
