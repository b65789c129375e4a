"""A quadratic model of the objective in the independent joints, by the pattern of composite rigid bodies.

With the matches held, `|r| <= |r|^2 / (2 d) + d / 2` with `d = sqrt(|r|^2 + eps^2)`, and `-lambda n.n' =
(lambda / 2)|n - n'|^2 - lambda`: a sum of squares that touches the DCD from above. Its gradient and Hessian are summed as
6-vectors and 6x6 blocks a joint (linear, then angular, about the source's centroid), carried from leaf to root and
projected on the joints' screws, so no dense Jacobian is formed.
"""

from typing import NamedTuple

import numpy as np

from cei_gym.arrays import Array
from cei_gym.compiled import njit

_SMOOTHING_M = 1e-3


class Quadratic(NamedTuple):
    """Gradient and Hessian, and the sums that lead to them.

    Attributes:
        gradient, hessian: (m,), (m, m) in the independent joints.
        pull: (N', 8) of each target pair: summed weight / d, force (3), lambda weight, source normals (3).
        force, block, screw: (n, 6), (n, 6, 6) upper triangles, (n, 6) of each joint.
    """

    gradient: Array
    hessian: Array
    pull: Array
    force: Array
    block: Array
    screw: Array


@njit(cache=True, nogil=True)
def empty_quadratic(target):
    m, joints = len(target.lower), len(target.leader)
    return Quadratic(
        np.empty(m),
        np.empty((m, m)),
        np.empty((len(target.pads), 8)),
        np.empty((joints, 6)),
        np.empty((joints, 6, 6)),
        np.empty((joints, 6)),
    )


@njit(cache=True, nogil=True)
def add_distance(target, source, lambda_m, pose, out):
    """Start `out` with the DCD's own forces and blocks."""
    out.pull[:] = 0.0
    out.force[:] = 0.0
    out.block[:] = 0.0
    everyone = np.arange(max(len(pose.match), len(pose.match_back)))
    _add_pulls(source.pairs, pose.pairs, everyone, pose.match, lambda_m, len(pose.match), out.pull)
    _add_pulls(source.pairs, pose.pairs, pose.match_back, everyone, lambda_m, len(pose.match_back), out.pull)
    _add_pads(pose.pairs, target.pad_joint, out.pull, out.force, out.block)


# Loops take arrays, not tuples of them: reaching into a tuple inside a loop costs more than the arithmetic.


@njit(cache=True, nogil=True)
def _add_pulls(source, target, of_source, of_target, lambda_m, count, pull):
    weight = 1.0 / count
    turn = weight * lambda_m
    for match in range(count):
        i, j = of_source[match], of_target[match]
        rx, ry, rz = target[0, j] - source[0, i], target[1, j] - source[1, i], target[2, j] - source[2, i]
        stiffness = weight / np.sqrt(rx * rx + ry * ry + rz * rz + _SMOOTHING_M * _SMOOTHING_M)
        pull[j, 0] += stiffness
        pull[j, 1] += stiffness * rx
        pull[j, 2] += stiffness * ry
        pull[j, 3] += stiffness * rz
        pull[j, 4] += turn
        pull[j, 5] += turn * source[3, i]
        pull[j, 6] += turn * source[4, i]
        pull[j, 7] += turn * source[5, i]


@njit(cache=True, nogil=True)
def _add_pads(pairs, pad_joint, pull, force, block):
    for j in range(len(pad_joint)):
        joint = pad_joint[j]
        if joint < 0:
            continue
        x, y, z = pairs[0, j], pairs[1, j], pairs[2, j]
        nx, ny, nz = pairs[3, j], pairs[4, j], pairs[5, j]
        k, turn = pull[j, 0], pull[j, 4]
        fx, fy, fz = pull[j, 1], pull[j, 2], pull[j, 3]
        mx, my, mz = pull[j, 5], pull[j, 6], pull[j, 7]
        force[joint, 0] += fx
        force[joint, 1] += fy
        force[joint, 2] += fz
        force[joint, 3] += y * fz - z * fy - (ny * mz - nz * my)
        force[joint, 4] += z * fx - x * fz - (nz * mx - nx * mz)
        force[joint, 5] += x * fy - y * fx - (nx * my - ny * mx)
        # J = [I, -[b]x]: k J^T J, and lambda (I - n n^T) for the turning normal
        block[joint, 0, 0] += k
        block[joint, 1, 1] += k
        block[joint, 2, 2] += k
        block[joint, 0, 4] += k * z
        block[joint, 0, 5] -= k * y
        block[joint, 1, 3] -= k * z
        block[joint, 1, 5] += k * x
        block[joint, 2, 3] += k * y
        block[joint, 2, 4] -= k * x
        block[joint, 3, 3] += k * (y * y + z * z) + turn * (1.0 - nx * nx)
        block[joint, 4, 4] += k * (x * x + z * z) + turn * (1.0 - ny * ny)
        block[joint, 5, 5] += k * (x * x + y * y) + turn * (1.0 - nz * nz)
        block[joint, 3, 4] -= k * x * y + turn * nx * ny
        block[joint, 3, 5] -= k * x * z + turn * nx * nz
        block[joint, 4, 5] -= k * y * z + turn * ny * nz


@njit(cache=True, nogil=True)
def add_contact(joint, point, normal, value, weight, out):
    """Add `(weight / 2) value^2`, where `value` falls as `point` (3,), fixed to a joint's frame, moves along `normal`."""
    w = np.empty(6)
    for i in range(3):
        w[i] = normal[i]
    w[3] = point[1] * normal[2] - point[2] * normal[1]
    w[4] = point[2] * normal[0] - point[0] * normal[2]
    w[5] = point[0] * normal[1] - point[1] * normal[0]
    for i in range(6):
        out.force[joint, i] -= weight * value * w[i]
        for l in range(i, 6):
            out.block[joint, i, l] += weight * w[i] * w[l]


@njit(cache=True, nogil=True)
def project(target, origin, pose, out):
    """Forces and blocks of joints to `out.gradient` and `out.hessian`; uses them up."""
    joints, leader, scale = target.joints, target.leader, target.scale
    gradient, hessian, screw, force, block = out.gradient, out.hessian, out.screw, out.force, out.block
    gradient[:] = 0.0
    hessian[:] = 0.0
    for k in range(len(leader)):
        ax, ay, az = pose.axis[k, 0], pose.axis[k, 1], pose.axis[k, 2]
        if joints.hinge[k]:
            x, y, z = origin[0] - pose.pos[k, 0], origin[1] - pose.pos[k, 1], origin[2] - pose.pos[k, 2]
            screw[k, 0], screw[k, 1], screw[k, 2] = ay * z - az * y, az * x - ax * z, ax * y - ay * x
            screw[k, 3], screw[k, 4], screw[k, 5] = ax, ay, az
        else:
            screw[k, 0], screw[k, 1], screw[k, 2] = ax, ay, az
            screw[k, 3], screw[k, 4], screw[k, 5] = 0.0, 0.0, 0.0
    c = np.empty(6)
    for k in range(len(leader) - 1, -1, -1):
        for i in range(6):
            total = 0.0
            for l in range(i):
                total += block[k, l, i] * screw[k, l]
            for l in range(i, 6):
                total += block[k, i, l] * screw[k, l]
            c[i] = total * scale[k]
        u = leader[k]
        for i in range(6):
            gradient[u] += scale[k] * screw[k, i] * force[k, i]
        other = k
        while other >= 0:
            v, total = leader[other], 0.0
            for i in range(6):
                total += screw[other, i] * c[i]
            total *= scale[other]
            hessian[u, v] += total
            if other != k:
                hessian[v, u] += total
            other = joints.parent[other]
        parent = joints.parent[k]
        if parent >= 0:
            for i in range(6):
                force[parent, i] += force[k, i]
                for l in range(i, 6):
                    block[parent, i, l] += block[k, i, l]
