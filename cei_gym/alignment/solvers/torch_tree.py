"""A tree of joints as constant matrices, so that a batch is placed by few wide operations."""

import numpy as np

from cei_gym.alignment.kernels.target import Target
from cei_gym.arrays import Array


def motions(joints) -> Array:
    """(n, 4, 16) a joint's own transform as a sum over 1, sin q, 1 - cos q (Rodrigues' formula) and q."""
    x, y, z = joints.axis.T
    cross = np.zeros((len(x), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross = (cross - cross.transpose(0, 2, 1)) * joints.hinge[:, None, None]
    terms = np.zeros((len(x), 4, 4, 4))
    terms[:, 0, :3, :3], terms[:, 0, :3, 3], terms[:, 0, 3, 3] = joints.rot, joints.pos, 1
    terms[:, 1, :3, :3], terms[:, 2, :3, :3] = joints.rot @ cross, joints.rot @ cross @ cross
    terms[:, 3, :3, 3] = np.einsum("nij,nj->ni", joints.rot, joints.axis) * ~joints.hinge[:, None]
    return terms.reshape(len(x), 4, 16)


def ancestors(parent: Array) -> list[Array]:
    """(n + 1,) of each joint and the base, the last: the ancestors 1, 2, 4, ... up, as far as there are any.

    Transforms multiplied with those of these ancestors in turn reach the base in as many products as a chain's length
    has bits.
    """
    base = len(parent)
    up, found = np.append(np.where(parent < 0, base, parent), base), []
    while (up != base).any():
        found.append(up)
        up = up[up]
    return found


def carried_by(parent: Array) -> Array:
    """(n + 1, n) whether a joint (the last row: the base) is moved by each joint."""
    carried = np.eye(len(parent) + 1, len(parent), dtype=bool)
    for k, up in enumerate(parent):
        carried[k] |= carried[up]
    return carried


def coupling(target: Target) -> Array:
    """(n, m) how joints follow the independent ones."""
    coupling = np.zeros((len(target.leader), len(target.lower)))
    coupling[np.arange(len(target.leader)), target.leader] = target.scale
    return coupling


def placing(pads: Array, carrier: Array, carriers: int) -> Array:
    """(4 K, 2 N') what rows of K frames, side by side, are multiplied with to place points and normals."""
    placing, each = np.zeros((carriers, 4, 2, len(pads))), np.arange(len(pads))
    for i in range(3):
        placing[carrier, i, 0, each], placing[carrier, i, 1, each] = pads[:, i], pads[:, 3 + i]
    placing[carrier, 3, 0, each] = 1
    return placing.reshape(4 * carriers, 2 * len(pads))
