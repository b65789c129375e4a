"""The kinematic tree reduced to its joints: what a solver needs, without the bodies between them."""

from typing import NamedTuple

import numpy as np

from cei_gym.arrays import Array
from cei_gym.kinematics.tree import TreeArrays


class JointTree(NamedTuple):
    """Joint frames; parents first. A joint's frame sits at its anchor and moves with it.

    Attributes:
        parent: (n,) the joint before it on the chain, or -1 for the base.
        rot, pos: (n, 3, 3), (n, 3) pose of a joint's frame in its parent's, all joints at their reference.
        axis: (n, 3) in the joint's own frame.
        hinge: (n,) hinge or slide.
        reference: (n,) position of each joint at which it is unmoved, rad or m.
    """

    parent: Array
    rot: Array
    pos: Array
    axis: Array
    hinge: Array
    reference: Array


class Attachment(NamedTuple):
    """Bodies as fixed to joint frames.

    Attributes:
        joint: (L,) the joint whose frame carries a body, or -1 for the base.
        rot, pos: (L, 3, 3), (L, 3) pose of the body in that frame.
    """

    joint: Array
    rot: Array
    pos: Array


def reduce_to_joints(tree: TreeArrays) -> tuple[JointTree, Attachment]:
    """A tree of bodies as a tree of joints, and where the bodies are on it."""
    bodies, joints = len(tree.parent), len(tree.hinge)
    carrier = np.full(bodies, -1)
    body_rot, body_pos = np.tile(np.eye(3), (bodies, 1, 1)), np.zeros((bodies, 3))
    parent, rot, pos = np.full(joints, -1), np.empty((joints, 3, 3)), np.empty((joints, 3))
    for body in range(1, bodies):
        up = tree.parent[body]
        on, R = carrier[up], body_rot[up] @ tree.rot[body]
        t = body_pos[up] + body_rot[up] @ tree.pos[body]
        for joint in range(tree.joint_start[body], tree.joint_start[body + 1]):
            parent[joint], rot[joint], pos[joint] = on, R, t + R @ tree.anchor[joint]
            on, R, t = joint, np.eye(3), -tree.anchor[joint]
        carrier[body], body_rot[body], body_pos[body] = on, R, t
    reduced = JointTree(parent, rot, pos, tree.axis.copy(), tree.hinge.copy(), tree.reference.copy())
    return reduced, Attachment(carrier, body_rot, body_pos)
