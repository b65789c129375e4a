"""Checkpoints of the original 3D Diffusion Policy and of Simple DP3: weights under our names, the normaliser in our terms."""

import copy
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from lerobot.configs import NormalizationMode
from lerobot.processor import PolicyAction, PolicyProcessorPipeline
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor

from lerobot_policy_dp3.configuration_dp3 import DP3Config
from lerobot_policy_dp3.modeling_dp3 import FLAT, DP3Policy
from lerobot_policy_dp3.processor_dp3 import make_dp3_pre_post_processors

NAMES = (
    (r"^model\.", "unet."),
    (r"\.blocks\.0\.", ".conv1."),
    (r"\.blocks\.1\.", ".conv2."),
    (r"^(unet\.(?:down|up)_modules\.\d+)\.[12]\.conv\.", r"\1.2."),
)
"""Pattern in a name of the original, and what stands there in ours, applied in this order.

The original's PointNet (`obs_encoder.extractor`) and state MLP (`obs_encoder.state_mlp`) have our names. Of its `model`, a UNet
with FiLM at every level, `blocks` are LeRobot's `conv1` and `conv2`; the layer that halves or doubles the rate has no wrapper, and
stands third also where, as in Simple DP3, there is one block before it.
"""
NORMALISER = "normalizer.params_dict."
STATE_KEY, ACTION_KEY, CLOUD_KEY = "agent_pos", "action", "point_cloud"
"""Names of the original's data."""


def from_original(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """State dict for `DP3Model`: `policy.model.load_state_dict(from_original(...))`. Until a policy is trained on, that acts.

    Args:
        weights: the original policy's state dict, as in its checkpoints under `state_dicts` (`model`, or `ema_model`).
            What it holds beside the networks is left out; `import_original` takes its normaliser, too.
    """
    renamed = {}
    for name, weight in weights.items():
        if not name.startswith(("obs_encoder.", "model.")):
            continue
        for pattern, ours in NAMES:
            name = re.sub(pattern, ours, name)
        renamed[name] = weight
    return renamed


def import_original(
    weights: Mapping[str, Tensor], config: DP3Config
) -> tuple[
    DP3Policy,
    PolicyProcessorPipeline[dict[str, Any], dict[str, Any]],
    PolicyProcessorPipeline[PolicyAction, PolicyAction],
]:
    """A policy that acts as the original does, and the steps before and after it; each has `save_pretrained`.

    Args:
        weights: the original policy's state dict, as in its checkpoints under `state_dicts` (`ema_model` is what acts there).
        config: its size, horizon and features; what normalises is replaced by the checkpoint's.

    Raises:
        ValueError: it was made for other features, or has what cannot be represented here.
        RuntimeError: networks are of another size.
    """
    config = copy.deepcopy(config)
    config.validate_features()
    assert config.robot_state_feature is not None and config.action_feature is not None
    names = {name.removeprefix(NORMALISER).partition(".")[0] for name in weights if name.startswith(NORMALISER)}
    if other := sorted(names - {STATE_KEY, ACTION_KEY, CLOUD_KEY}):
        raise ValueError(f"the original looks at {', '.join(other)}, which this policy does not.")
    channels = config.cloud_feature.shape[1]
    sizes = {
        STATE_KEY: config.robot_state_feature.shape[0],
        ACTION_KEY: config.action_feature.shape[0],
        CLOUD_KEY: channels,
    }
    ends = {key: _ends(weights, key, size, config.use_colours) for key, size in sizes.items()}
    low, high = ends[CLOUD_KEY]
    if (high - low).min() < FLAT:
        raise ValueError(f"the original stretches clouds that span less than {FLAT} m, which is not done here.")
    config.cloud_bounds = tuple(low.tolist()), tuple(high.tolist())
    config.min_range = 0.0
    config.normalization_mapping = {"STATE": NormalizationMode.MIN_MAX, "ACTION": NormalizationMode.MIN_MAX}
    stats: dict[str, dict[str, Tensor]] = {}
    for ours, theirs in ((OBS_STATE, STATE_KEY), (ACTION, ACTION_KEY)):
        least, largest = ends[theirs]
        stats[ours] = {"min": torch.from_numpy(least), "max": torch.from_numpy(largest)}
    policy = DP3Policy(config)
    policy.model.load_state_dict(from_original(weights))
    return policy, *make_dp3_pre_post_processors(config, stats)


def _ends(weights: Mapping[str, Tensor], key: str, size: int, colours: bool) -> tuple[np.ndarray, np.ndarray]:
    """What the original's normaliser, `scale * x + offset`, turns into -1 and 1, (size,) each, float32.

    Raises:
        ValueError: there is none, it is of another size, or turns them into the same.
    """
    try:
        scale, offset = (
            weights[f"{NORMALISER}{key}.{name}"].detach().cpu().double().numpy() for name in ("scale", "offset")
        )
    except KeyError as error:
        raise ValueError(
            f"these weights have no normaliser of {key} ({error.args[0]}): they are not a whole policy's."
        ) from None
    if key == CLOUD_KEY and not colours and len(scale) == 6:
        scale, offset = scale[:size], offset[:size]  # the original normalises colours, and then drops them
    if len(scale) not in (1, size) or scale.shape != offset.shape:
        raise ValueError(f"the original's normaliser of {key} is of {len(scale)} entries, not of {size}.")
    scale, offset = (np.broadcast_to(part, size) for part in (scale, offset))
    if not (np.isfinite(scale).all() and np.isfinite(offset).all() and (scale > 0).all()):
        raise ValueError(f"the original's normaliser of {key} has a scale that is not above 0.")
    return ((-1 - offset) / scale).astype(np.float32), ((1 - offset) / scale).astype(np.float32)
