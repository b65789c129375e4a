"""What a step before a policy reads of an observation: joints, and a camera's depth and picture, checked against the policy's data."""

import numpy as np
import torch
from lerobot.processor import RobotObservation
from lerobot.utils.constants import OBS_IMAGES, OBS_STATE
from torch import Tensor

from cei_converters.dataset.schema import DEPTH_PREFIX
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.errors import CEIError
from lerobot_robot_cei.trained_on import TrainedOn

_MM_PER_M = 1000
_DEEPEST_M = 60.0


def joints_of(observation: RobotObservation, known: TrainedOn) -> Array:
    """(B, n) joint positions, rad or m.

    Raises:
        CEIError: they are not as many as the policy's.
    """
    states = np.asarray(observation[OBS_STATE].cpu(), float)
    if states.ndim != 2 or states.shape[1] != len(known.joint_names):
        raise CEIError(
            f"{OBS_STATE} has shape {states.shape}; the policy knows {len(known.joint_names)} joints: "
            f"{', '.join(known.joint_names)}. Use --robot.type=cei."
        )
    return states


def has_depth(camera: Camera, observation: RobotObservation) -> bool:
    """Whether there is depth beside a camera's picture."""
    return any(key in observation for key in _depth_keys(camera)[:2])


def depth_m_of(camera: Camera, observation: RobotObservation) -> Array:
    """(B, H, W) float32, m; of whole millimetres in float32, as datasets have it: other roundings would order points otherwise.

    Raises:
        CEIError: there is none, it is of another size, or deeper than cameras see.
    """
    images = _image(camera, observation, _depth_keys(camera), 1)
    if not images.is_floating_point():
        return (images.numpy().astype(np.float32)) / np.float32(_MM_PER_M)
    if images.numel() and float(images.max()) > _DEEPEST_M:
        raise CEIError(
            f"depth of camera {camera.name!r} reaches {float(images.max()):g}; as fractions it should be in m."
        )
    return images.numpy().astype(np.float32)


def picture_of(camera: Camera, observation: RobotObservation) -> Array:
    """(B, H, W, 3) uint8.

    Raises:
        CEIError: there is none, or it is of another size.
    """
    images = _image(camera, observation, [f"{OBS_IMAGES}.{camera.name}"], 3)
    return (images * 255).round().to(torch.uint8).numpy()


def _depth_keys(camera: Camera) -> list[str]:
    return [f"{OBS_IMAGES}.{camera.name}_depth", f"{DEPTH_PREFIX}{camera.name}", f"{OBS_IMAGES}.{camera.name}"]


def _image(camera: Camera, observation: RobotObservation, keys: list[str], channels: int) -> Tensor:
    """(B, H, W) or (B, H, W, 3) of the first of these keys whose image has so many channels."""
    size = (camera.height, camera.width)
    shown = []
    for key in keys:
        if key not in observation:
            continue
        image = torch.as_tensor(observation[key]).cpu()
        if image.ndim == 4 and image.shape[1:] == (channels, *size):
            image = image.permute(0, 2, 3, 1)
        if image.ndim == 4 and image.shape[1:] == (*size, channels):
            return image[..., 0] if channels == 1 else image
        shown.append(f"{key} {tuple(image.shape[1:])}")
    here = [key for key in observation if key.startswith((OBS_IMAGES, DEPTH_PREFIX))]
    raise CEIError(
        f"camera {camera.name!r} of the policy's data gives images of {camera.width}x{camera.height}, {channels} channel(s), as "
        f"{keys[0]}; here is {', '.join(shown) or ', '.join(here) or 'no picture'}."
    )
