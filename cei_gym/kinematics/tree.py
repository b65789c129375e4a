"""Batched forward kinematics and Jacobians on arrays read from a compiled MuJoCo model."""

from typing import NamedTuple

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.compiled import njit
from cei_gym.embodiment.embodiment import Embodiment


class TreeArrays(NamedTuple):
    """What compiled code needs of a tree; bodies and joints in MuJoCo's order (parents first).

    Attributes:
        parent: (L,) parent body.
        pos, rot: (L, 3), (L, 3, 3) pose of a body in its parent at the reference configuration.
        joint_start: (L + 1,) joints of body i are `joint_start[i] : joint_start[i + 1]`.
        joint_parent: (n,) the joint before it on the chain, or -1.
        body_joint: (L,) the last joint that moves a body, or -1.
        hinge: (n,) hinge or slide.
        axis, anchor: (n, 3) in the body's frame.
        reference: (n,) position at which the model was drawn (`ref`).
    """

    parent: Array
    pos: Array
    rot: Array
    joint_start: Array
    joint_parent: Array
    body_joint: Array
    hinge: Array
    axis: Array
    anchor: Array
    reference: Array


@njit(cache=True, nogil=True)
def forward_into(tree: TreeArrays, qpos, rot, pos, axis, anchor):
    """Fill link poses (rot, pos) and joint screws (axis, anchor), all in the base frame, for one configuration."""
    rot[0] = np.eye(3)
    pos[0] = 0.0
    for body in range(1, len(tree.parent)):
        up = tree.parent[body]
        for i in range(3):
            pos[body, i] = pos[up, i]
            for k in range(3):
                pos[body, i] += rot[up, i, k] * tree.pos[body, k]
                total = 0.0
                for j in range(3):
                    total += rot[up, i, j] * tree.rot[body, j, k]
                rot[body, i, k] = total
        for joint in range(tree.joint_start[body], tree.joint_start[body + 1]):
            for i in range(3):
                axis[joint, i] = 0.0
                anchor[joint, i] = pos[body, i]
                for k in range(3):
                    axis[joint, i] += rot[body, i, k] * tree.axis[joint, k]
                    anchor[joint, i] += rot[body, i, k] * tree.anchor[joint, k]
            value = qpos[joint] - tree.reference[joint]
            if tree.hinge[joint]:
                rotate(rot[body], tree.axis[joint, 0], tree.axis[joint, 1], tree.axis[joint, 2], value)
                for i in range(3):
                    pos[body, i] = anchor[joint, i]
                    for k in range(3):
                        pos[body, i] -= rot[body, i, k] * tree.anchor[joint, k]
            else:
                for i in range(3):
                    pos[body, i] += axis[joint, i] * value


@njit(cache=True, nogil=True)
def rotate(rot, x, y, z, angle):
    """rot <- rot @ exp([(x, y, z)] angle), by Rodrigues' formula."""
    c, s = np.cos(angle), np.sin(angle)
    v = 1.0 - c
    m00, m01, m02 = c + x * x * v, x * y * v - z * s, x * z * v + y * s
    m10, m11, m12 = y * x * v + z * s, c + y * y * v, y * z * v - x * s
    m20, m21, m22 = z * x * v - y * s, z * y * v + x * s, c + z * z * v
    for i in range(3):
        a, b, d = rot[i, 0], rot[i, 1], rot[i, 2]
        rot[i, 0] = a * m00 + b * m10 + d * m20
        rot[i, 1] = a * m01 + b * m11 + d * m21
        rot[i, 2] = a * m02 + b * m12 + d * m22


@njit(cache=True, nogil=True)
def _forward_batch(tree, qpos):
    batch, links, joints = len(qpos), len(tree.parent), len(tree.hinge)
    rot, pos = np.empty((batch, links, 3, 3)), np.empty((batch, links, 3))
    axis, anchor = np.empty((batch, joints, 3)), np.empty((batch, joints, 3))
    for b in range(batch):
        forward_into(tree, qpos[b], rot[b], pos[b], axis[b], anchor[b])
    return rot, pos, axis, anchor


@njit(cache=True, nogil=True)
def _jacobian_batch(tree, axis, anchor, body, points):
    batch, joints = len(points), len(tree.hinge)
    out = np.zeros((batch, 6, joints))
    for b in range(batch):
        joint = tree.body_joint[body]
        while joint >= 0:
            a = axis[b, joint]
            if tree.hinge[joint]:
                out[b, :3, joint] = np.cross(a, points[b] - anchor[b, joint])
                out[b, 3:, joint] = a
            else:
                out[b, :3, joint] = a
            joint = tree.joint_parent[joint]
    return out


class KinematicTree:
    """Forward kinematics of an embodiment in its base frame.

    Args:
        embodiment: whose links (bodies of its model) are posed.
    """

    def __init__(self, embodiment: Embodiment) -> None:
        self.embodiment = embodiment
        self.arrays = _arrays(embodiment.model)

    def forward(self, qpos: Array) -> Array:
        """Poses of all links.

        Args:
            qpos: (..., n) joint positions, rad or m.

        Returns:
            T_base_links: (..., L, 4, 4).
        """
        rot, pos, _, _ = self._screws(qpos)
        T = np.zeros((*rot.shape[:2], 4, 4))
        T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = rot, pos, 1.0
        return T.reshape(*np.shape(qpos)[:-1], *T.shape[1:])

    def jacobian(self, qpos: Array, body: int, point_link: Array) -> Array:
        """Geometric Jacobian of a point fixed to a link.

        Args:
            qpos: (..., n) joint positions, rad or m.
            body: index of the link.
            point_link: (3,) the point in the link's frame, m.

        Returns:
            (..., 6, n): linear (m) then angular (rad) velocity in the base frame for each joint's velocity.
        """
        rot, pos, axis, anchor = self._screws(qpos)
        points = np.ascontiguousarray(pos[:, body] + rot[:, body] @ np.asarray(point_link, float))
        J = _jacobian_batch(self.arrays, axis, anchor, body, points)
        return J.reshape(*np.shape(qpos)[:-1], *J.shape[1:])

    def moving(self, bodies: Array) -> Array:
        """(n,) which joints move any of some links, given by their indices."""
        moves = np.zeros(len(self.arrays.hinge), bool)
        for joint in self.arrays.body_joint[np.unique(bodies)]:
            while joint >= 0:
                moves[joint] = True
                joint = self.arrays.joint_parent[joint]
        return moves

    def _screws(self, qpos: Array):
        n = len(self.arrays.hinge)
        if np.shape(qpos)[-1] != n:
            raise ValueError(f"{self.embodiment.name} has {n} joints; qpos has shape {np.shape(qpos)}")
        return _forward_batch(self.arrays, np.ascontiguousarray(qpos, float).reshape(-1, n))


def _arrays(model: mujoco.MjModel) -> TreeArrays:
    quat_wxyz = model.body_quat
    joint_start = np.concatenate([[0], np.cumsum(model.body_jntnum)])
    joint_parent = np.full(model.njnt, -1)
    body_joint = np.full(model.nbody, -1)
    for body in range(1, model.nbody):
        last = body_joint[model.body_parentid[body]]
        for joint in range(joint_start[body], joint_start[body + 1]):
            joint_parent[joint] = last
            last = joint
        body_joint[body] = last
    return TreeArrays(
        parent=model.body_parentid.astype(np.int64),
        pos=model.body_pos.copy(),
        rot=Rotation.from_quat(quat_wxyz, scalar_first=True).as_matrix(),
        joint_start=joint_start.astype(np.int64),
        joint_parent=joint_parent.astype(np.int64),
        body_joint=body_joint.astype(np.int64),
        hinge=model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE,
        axis=model.jnt_axis.copy(),
        anchor=model.jnt_pos.copy(),
        reference=model.qpos0.copy(),
    )
