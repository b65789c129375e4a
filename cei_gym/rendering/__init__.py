"""Depth, segmentation and simple pictures of a MuJoCo scene, without any graphics library."""

from cei_gym.embodiment.colours import geom_colours
from cei_gym.rendering.camera import DepthCamera
from cei_gym.rendering.noise import DepthNoise, add_noise, as_noise, miscalibrated
from cei_gym.rendering.pinhole import camera_from_mujoco, image_points, look_at, project, resized, unproject
from cei_gym.rendering.portrait import Portrait, lighter
from cei_gym.rendering.shading import shade
from cei_gym.rendering.splat import splat

__all__ = [
    "DepthCamera",
    "DepthNoise",
    "Portrait",
    "add_noise",
    "as_noise",
    "camera_from_mujoco",
    "geom_colours",
    "image_points",
    "lighter",
    "look_at",
    "miscalibrated",
    "project",
    "resized",
    "shade",
    "splat",
    "unproject",
]
