"""Before and after the policy: LeRobot's default steps, with statistics that suit a robot at work."""

import logging
from pathlib import Path
from typing import Any

import torch
from lerobot.processor import PolicyAction, PolicyProcessorPipeline, ProcessorStep, ProcessorStepRegistry
from lerobot.processor.factory import make_default_policy_processor_steps, make_policy_processor_pipelines
from lerobot.utils.constants import ACTION, OBS_STATE

from lerobot_policy_dp3.configuration_dp3 import DP3Config

CLOUDS = "cei_clouds"
"""The step that makes clouds on a robot, if somebody has registered one: `lerobot_robot_cei`, for datasets of CEI-Gym."""


def make_dp3_pre_post_processors(
    config: DP3Config, dataset_stats: dict[str, dict[str, torch.Tensor]] | None = None, dataset_meta: Any | None = None
) -> tuple[
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]
]:
    """The steps before the policy (clouds, normalise the state) and after it (back to rad and m); see `DP3Config.min_range`.

    A dataset that says whose demonstrations it has, and with which cameras, gives checkpoints what a robot needs to make such clouds (`CLOUDS`).

    Clouds are left to the policy, which knows where their channels lie in a flat one (`DP3Config.cloud_bounds`).
    """
    stats = dict(dataset_stats or {})
    for key in {OBS_STATE, ACTION} & set(stats):
        stats[key] = _widened(stats[key], config.min_range)
    steps = make_default_policy_processor_steps(config, stats or None)
    steps.normalize.normalize_observation_keys = {OBS_STATE}
    return make_policy_processor_pipelines(
        input_steps=[
            steps.rename_observations,
            steps.add_batch_dim,
            *_clouds(dataset_meta or getattr(config, "_runtime_dataset_meta", None)),  # where LeRobot keeps it
            steps.to_device,
            steps.normalize,
        ],
        output_steps=[steps.unnormalize, steps.to_cpu],
    )


def _clouds(dataset_meta: Any | None) -> list[ProcessorStep]:
    """The step that makes clouds as a dataset has them; none where the dataset says too little, or nothing makes them."""
    if dataset_meta is None:
        return []
    try:
        step: Any = ProcessorStepRegistry.get(CLOUDS)
    except KeyError:
        logging.info("Checkpoints cannot make clouds from a robot's depth: lerobot_robot_cei is not installed.")
        return []
    made = step.of_dataset(Path(dataset_meta.root))
    return [] if made is None else [made]


def _widened(stats: dict[str, Any], least: float) -> dict[str, Any]:
    """Statistics whose max and min lie `least` apart at least, about the same middle."""
    low, high = (torch.as_tensor(stats[name]) for name in ("min", "max"))
    middle, half = (low + high) / 2, ((high - low) / 2).clamp(min=least / 2)
    return {**stats, "min": middle - half, "max": middle + half}
