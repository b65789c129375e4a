"""Synthesising a point cloud (paper, section IV-C): crop, mask the robot, sample another one, thin."""

from cei_gym.pointcloud.crop import crop
from cei_gym.pointcloud.fuse import frame_points, fuse_depth
from cei_gym.pointcloud.mask import RobotMask
from cei_gym.pointcloud.options import CloudOptions
from cei_gym.pointcloud.sample import SurfaceSampler
from cei_gym.pointcloud.synthesise import CloudSynthesiser
from cei_gym.pointcloud.thin import farthest_point_sample, first_of_voxels, share_sample

__all__ = [
    "CloudOptions",
    "CloudSynthesiser",
    "RobotMask",
    "SurfaceSampler",
    "crop",
    "farthest_point_sample",
    "first_of_voxels",
    "frame_points",
    "fuse_depth",
    "share_sample",
]
