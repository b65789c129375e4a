"""The Directional Chamfer Distance of one configuration, equation (1): kinematics, pads, matching."""

import numpy as np
from numba import njit

from cei_gym.alignment.kernels.target import empty_pose, empty_source, load_source

# Without NaN or infinity in sight, loops become wide instructions.
_WIDE = {"contract", "arcp", "nsz", "reassoc", "nnan", "ninf", "afn"}
_FAST = {"contract", "arcp", "nsz", "reassoc"}


@njit(cache=True, nogil=True, fastmath=_FAST)
def evaluate(target, source, lambda_m, u, pose):
    """DCD at u, metres; fills `pose`."""
    place_joints(target, u, pose)
    _place_pads(target, source.origin, pose)
    match(source.pairs32, pose, np.float32(lambda_m))
    return _distance(source.pairs, pose, lambda_m)


@njit(cache=True, nogil=True, fastmath=_FAST)
def place_joints(target, u, pose):
    joints = target.joints
    local = np.empty((3, 3))
    for k in range(len(joints.parent)):
        up = joints.parent[k]
        value = u[target.leader[k]] * target.scale[k] + target.offset[k] - joints.reference[k]
        x, y, z = joints.axis[k, 0], joints.axis[k, 1], joints.axis[k, 2]
        R = joints.rot[k]
        if joints.hinge[k]:
            # Rodrigues' formula
            c, s = np.cos(value), np.sin(value)
            v = 1.0 - c
            m00, m01, m02 = c + x * x * v, x * y * v - z * s, x * z * v + y * s
            m10, m11, m12 = y * x * v + z * s, c + y * y * v, y * z * v - x * s
            m20, m21, m22 = z * x * v - y * s, z * y * v + x * s, c + z * z * v
            for i in range(3):
                a, b, d = R[i, 0], R[i, 1], R[i, 2]
                local[i, 0] = a * m00 + b * m10 + d * m20
                local[i, 1] = a * m01 + b * m11 + d * m21
                local[i, 2] = a * m02 + b * m12 + d * m22
        else:
            for i in range(3):
                local[i, 0], local[i, 1], local[i, 2] = R[i, 0], R[i, 1], R[i, 2]
        t0, t1, t2 = joints.pos[k, 0], joints.pos[k, 1], joints.pos[k, 2]
        for i in range(3):
            if up < 0:
                for j in range(3):
                    pose.rot[k, i, j] = local[i, j]
                pose.pos[k, i] = joints.pos[k, i]
            else:
                a, b, d = pose.rot[up, i, 0], pose.rot[up, i, 1], pose.rot[up, i, 2]
                for j in range(3):
                    pose.rot[k, i, j] = a * local[0, j] + b * local[1, j] + d * local[2, j]
                pose.pos[k, i] = pose.pos[up, i] + a * t0 + b * t1 + d * t2
            pose.axis[k, i] = pose.rot[k, i, 0] * x + pose.rot[k, i, 1] * y + pose.rot[k, i, 2] * z
        if not joints.hinge[k]:
            for i in range(3):
                pose.pos[k, i] += pose.axis[k, i] * value


@njit(cache=True, nogil=True, fastmath=_FAST)
def _place_pads(target, origin, pose):
    for n in range(len(target.pad_joint)):
        k = target.pad_joint[n]
        p = target.pads[n]
        for i in range(3):
            if k < 0:
                x, y = p[i], p[3 + i]
            else:
                a, b, d = pose.rot[k, i, 0], pose.rot[k, i, 1], pose.rot[k, i, 2]
                x = pose.pos[k, i] + a * p[0] + b * p[1] + d * p[2]
                y = a * p[3] + b * p[4] + d * p[5]
            pose.pairs[i, n], pose.pairs[3 + i, n] = x - origin[i], y
            pose.pairs32[i, n], pose.pairs32[3 + i, n] = x - origin[i], y


@njit(cache=True, nogil=True, fastmath=_WIDE)
def match(pairs, pose, lambda_m):
    """Nearest pair in both directions, all in single precision: fills `pose.match` and `pose.match_back`."""
    pose.best_back[:] = np.float32(np.inf)
    pose.match_back[:] = np.int32(0)
    x, y, z, nx, ny, nz = (
        pose.pairs32[0],
        pose.pairs32[1],
        pose.pairs32[2],
        pose.pairs32[3],
        pose.pairs32[4],
        pose.pairs32[5],
    )
    # Costs are kept positive: then their bits, read as integers, have the same order, and integer minima vectorise.
    offset = np.float32(1.01) * abs(lambda_m) + np.float32(1e-6)
    row = pose.row
    bits = row.view(np.int32)
    for i in range(pairs.shape[1]):
        a, b, c = pairs[0, i], pairs[1, i], pairs[2, i]
        na, nb, nc = lambda_m * pairs[3, i], lambda_m * pairs[4, i], lambda_m * pairs[5, i]
        row_costs(a, b, c, na, nb, nc, offset, x, y, z, nx, ny, nz, row)
        pose.match[i] = _first(bits, _least(bits))
        _keep_better(row, np.int32(i), pose.best_back, pose.match_back)


# One loop a function: the compiler vectorises each, but not their union.


@njit(cache=True, nogil=True, fastmath=_WIDE)
def row_costs(a, b, c, na, nb, nc, offset, x, y, z, nx, ny, nz, row):
    for j in range(len(row)):
        dx, dy, dz = x[j] - a, y[j] - b, z[j] - c
        row[j] = np.sqrt(dx * dx + dy * dy + dz * dz) - (na * nx[j] + nb * ny[j] + nc * nz[j]) + offset


@njit(cache=True, nogil=True)
def _least(bits):
    least = np.int32(2147483647)
    for j in range(len(bits)):
        least = min(least, bits[j])
    return least


@njit(cache=True, nogil=True)
def _first(bits, value):
    n = np.int32(len(bits))
    where = n
    for j in range(len(bits)):
        where = min(where, np.int32(j) if bits[j] == value else n)
    return where


@njit(cache=True, nogil=True, fastmath=_WIDE)
def _keep_better(row, i, best, which):
    for j in range(len(row)):
        better = row[j] < best[j]
        best[j] = row[j] if better else best[j]
        which[j] = i if better else which[j]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _distance(source, pose, lambda_m):
    forth, back = 0.0, 0.0
    for i in range(source.shape[1]):
        forth += _cost(source, i, pose.pairs, pose.match[i], lambda_m)
    for j in range(pose.pairs.shape[1]):
        back += _cost(source, pose.match_back[j], pose.pairs, j, lambda_m)
    return forth / source.shape[1] + back / pose.pairs.shape[1]


@njit(cache=True, nogil=True, fastmath=_FAST)
def _cost(source, i, target, j, lambda_m):
    dx, dy, dz = target[0, j] - source[0, i], target[1, j] - source[1, i], target[2, j] - source[2, i]
    cosine = source[3, i] * target[3, j] + source[4, i] * target[4, j] + source[5, i] * target[5, j]
    return np.sqrt(dx * dx + dy * dy + dz * dz) - lambda_m * cosine


@njit(cache=True, nogil=True)
def matched(target, points, normals, u, lambda_m):
    """Mean distance (T,) m and mean angle between normals (T,) rad of the pairs that match at (T, m) configurations."""
    distance, angle = np.zeros(len(u)), np.zeros(len(u))
    source, pose = empty_source(points.shape[1]), empty_pose(target, points.shape[1])
    for t in range(len(u)):
        load_source(points[t], normals[t], source)
        evaluate(target, source, lambda_m, u[t], pose)
        matches = len(pose.match) + len(pose.match_back)
        for k in range(matches):
            forth = k < len(pose.match)
            i = k if forth else pose.match_back[k - len(pose.match)]
            j = pose.match[k] if forth else k - len(pose.match)
            squared, cosine = 0.0, 0.0
            for c in range(3):
                squared += (source.pairs[c, i] - pose.pairs[c, j]) ** 2
                cosine += source.pairs[3 + c, i] * pose.pairs[3 + c, j]
            distance[t] += np.sqrt(squared) / matches
            angle[t] += np.arccos(min(1.0, max(-1.0, cosine))) / matches
    return distance, angle
