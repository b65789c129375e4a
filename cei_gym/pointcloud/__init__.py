"""Synthesising a point cloud (paper, section IV-C): crop, mask the robot, sample another one, thin."""

from cei_gym.pointcloud.crop import crop
from cei_gym.pointcloud.fuse import fuse_depth
from cei_gym.pointcloud.mask import RobotMask
from cei_gym.pointcloud.sample import SurfaceSampler
from cei_gym.pointcloud.thin import farthest_point_sample

__all__ = ["RobotMask", "SurfaceSampler", "crop", "farthest_point_sample", "fuse_depth"]
