"""Kinematics of an embodiment: compiled forward kinematics and Jacobians, and the same chain in torch."""

from cei_gym.kinematics.tree import KinematicTree

__all__ = ["KinematicTree"]
