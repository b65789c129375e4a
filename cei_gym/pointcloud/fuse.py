"""One cloud from the images of several cameras."""

from collections.abc import Mapping

import numpy as np

from cei_gym.arrays import Array
from cei_gym.demonstration import Scene
from cei_gym.errors import CEIError
from cei_gym.rendering import unproject


def fuse_depth(scene: Scene, depth_m: Mapping[str, Array], rgb: Mapping[str, Array] | None = None) -> Array:
    """Points that the scene's cameras see.

    Args:
        scene: whose cameras are used, those that have an image.
        depth_m: camera name to depth (H, W), metres, 0 where unknown.
        rgb: camera name to the picture (H, W, 3) uint8 that belongs to the depth, pixel for pixel; for colours.

    Returns:
        (N, 3) points in the world, metres; with pictures (N, 6), and their colours in [0, 1].

    Raises:
        CEIError: an image is not of its camera's size, or a picture is missing.
    """
    cameras = [camera for camera in scene.cameras if camera.name in depth_m]
    clouds = [unproject(depth_m[camera.name], camera) for camera in cameras]
    if rgb:
        clouds = [
            np.concatenate([points, _colours(camera.name, depth_m, rgb)], axis=1)
            for camera, points in zip(cameras, clouds, strict=True)
        ]
    return np.concatenate(clouds) if clouds else np.zeros((0, 6 if rgb else 3))


def frame_points(
    scene: Scene,
    depth_m: Mapping[str, Array],
    rgb: Mapping[str, Array],
    cloud_world: Array | None,
    colours: bool,
) -> Array | None:
    """All that is known of a frame's surfaces, from images or from a cloud.

    Images come first, since clouds are thinned when recorded; but not where colours are wanted and only the cloud has them.

    Args:
        scene, depth_m, rgb: see `fuse_depth`; the mappings may be empty.
        cloud_world: (N, 3), or (N, 6) with colours, m, world; or None.
        colours: whether they are wanted.

    Returns:
        (N, 3 or 6), m, world; None if there is neither image nor cloud.
    """
    pictures = rgb if colours and depth_m.keys() <= rgb.keys() else None  # of all cameras, or of none
    only_cloud_has_colours = colours and not pictures and cloud_world is not None and cloud_world.shape[1] == 6
    if not depth_m or only_cloud_has_colours:
        return cloud_world
    return fuse_depth(scene, depth_m, pictures)


def _colours(camera: str, depth_m: Mapping[str, Array], rgb: Mapping[str, Array]) -> Array:
    """(N, 3) in [0, 1], a row for each pixel with a depth."""
    depth, picture = depth_m[camera], rgb.get(camera)
    shape = None if picture is None else picture.shape
    if picture is None or shape != (*depth.shape, 3):
        raise CEIError(f"camera {camera!r} has depth {depth.shape} but a picture of shape {shape}.")
    return picture[np.isfinite(depth) & (depth > 0)] / 255
