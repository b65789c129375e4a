"""One cloud from the depth images of several cameras."""

from collections.abc import Mapping

import numpy as np

from cei_gym.demonstration import Scene
from cei_gym.rendering import unproject


def fuse_depth(scene: Scene, depth_m: Mapping[str, np.ndarray]) -> np.ndarray:
    """Points that the scene's cameras see.

    Args:
        scene: whose cameras are used, those that have an image.
        depth_m: camera name to depth (H, W), metres, 0 where unknown.

    Returns:
        (N, 3) points in the world, metres.
    """
    clouds = [unproject(depth_m[c.name], c) for c in scene.cameras if c.name in depth_m]
    return np.concatenate(clouds) if clouds else np.zeros((0, 3))
