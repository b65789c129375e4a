"""Depth, segmentation and simple pictures of a MuJoCo scene, without any graphics library."""

from cei_gym.rendering.camera import DepthCamera
from cei_gym.rendering.pinhole import camera_from_mujoco, look_at, unproject
from cei_gym.rendering.shading import geom_colours, shade

__all__ = ["DepthCamera", "camera_from_mujoco", "geom_colours", "look_at", "shade", "unproject"]
