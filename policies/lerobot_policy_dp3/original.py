"""Weights of the original 3D Diffusion Policy under our names; the modules are the same."""

import re
from collections.abc import Mapping

from torch import Tensor

NAMES = (
    (r"^model\.", "unet."),
    (r"\.blocks\.0\.", ".conv1."),
    (r"\.blocks\.1\.", ".conv2."),
    (r"^(unet\.(?:down|up)_modules\.\d+\.2)\.conv\.", r"\1."),
)
"""Pattern in a name of the original, and what stands there in ours, applied in this order.

The original's PointNet (`obs_encoder.extractor`) and state MLP (`obs_encoder.state_mlp`) have our names. Of its `model`, a UNet
with FiLM at every level, `blocks` are LeRobot's `conv1` and `conv2`, and the layer that halves or doubles the rate has no wrapper.
"""


def from_original(weights: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """State dict for `DP3Model`: `policy.model.load_state_dict(from_original(...))`. Until a policy is trained on, that acts.

    Args:
        weights: the original policy's state dict, as in its checkpoints under `state_dicts` (`model`, or `ema_model`).
            What it holds beside the networks (its normaliser, a mask) is left out: here dataset statistics normalise.
    """
    renamed = {}
    for name, weight in weights.items():
        if not name.startswith(("obs_encoder.", "model.")):
            continue
        for pattern, ours in NAMES:
            name = re.sub(pattern, ours, name)
        renamed[name] = weight
    return renamed
