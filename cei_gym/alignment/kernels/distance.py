"""The Directional Chamfer Distance of one configuration, equation (1): kinematics, pads, matching."""

import numpy as np

from cei_gym.alignment.kernels.target import FINITE, empty_pose, empty_source, load_source, radius
from cei_gym.compiled import njit
from cei_gym.kinematics.tree import rotate


@njit(cache=True, nogil=True)
def evaluate(target, source, lambda_m, u, pose):
    """DCD at u, metres; fills `pose`."""
    place_joints(target, u, pose)
    _place_pads(target, source.origin, pose)
    match(source, pose, np.float32(lambda_m))
    return _distance(source.pairs, pose, lambda_m)


@njit(cache=True, nogil=True)
def place_joints(target, u, pose):
    joints = target.joints
    local = np.empty((3, 3))
    for k in range(len(joints.parent)):
        up = joints.parent[k]
        value = u[target.leader[k]] * target.scale[k] + target.offset[k] - joints.reference[k]
        x, y, z = joints.axis[k, 0], joints.axis[k, 1], joints.axis[k, 2]
        R = joints.rot[k]
        for i in range(3):
            local[i, 0], local[i, 1], local[i, 2] = R[i, 0], R[i, 1], R[i, 2]
        if joints.hinge[k]:
            rotate(local, x, y, z, value)
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


@njit(cache=True, nogil=True)
def _place_pads(target, origin, pose):
    rot, pos, pads, pad_joint, pairs, pairs32 = (
        pose.rot,
        pose.pos,
        target.pads,
        target.pad_joint,
        pose.pairs,
        pose.pairs32,
    )
    for n in range(len(pad_joint)):
        k = pad_joint[n]
        for i in range(3):
            if k < 0:
                x, y = pads[n, i], pads[n, 3 + i]
            else:
                a, b, d = rot[k, i, 0], rot[k, i, 1], rot[k, i, 2]
                x = pos[k, i] + a * pads[n, 0] + b * pads[n, 1] + d * pads[n, 2]
                y = a * pads[n, 3] + b * pads[n, 4] + d * pads[n, 5]
            pairs[i, n], pairs[3 + i, n] = x - origin[i], y
            pairs32[i, n], pairs32[3 + i, n] = x - origin[i], y
    pose.radius[0] = radius(pairs)


@njit(cache=True, nogil=True, fastmath=FINITE)
def match(source, pose, lambda_m):
    """Nearest pair in both directions, in single precision: fills `pose.match` and `pose.match_back`.

    Costs become integers with room for an index below them, so that the least integer brings its place along; minima of
    integers vectorise where a search for the place of a minimum does not. Costs are told apart to 2^-24 of the largest.
    """
    n_source, n_target = source.pairs32.shape[1], pose.pairs32.shape[1]
    bits = np.int32(0)
    while (1 << bits) < max(n_source, n_target):
        bits += np.int32(1)
    mask = np.int32((1 << bits) - 1)
    least_m = np.float32(1.01) * lambda_m + np.float32(1e-6)  # keeps costs positive
    largest_m = np.float32(source.radius[0] + pose.radius[0]) + np.float32(2.0) * least_m
    scale = np.float32((1 << (31 - bits)) - 128) / largest_m
    p, q, back, found, found_back = source.pairs32, pose.pairs32, pose.keys, pose.match, pose.match_back
    x, y, z, nx, ny, nz = q[0], q[1], q[2], q[3], q[4], q[5]
    for j in range(n_target):
        back[j] = np.int32(2147483647)
    turn = lambda_m * scale
    for i in range(n_source):
        key = match_one(
            p[0, i],
            p[1, i],
            p[2, i],
            turn * p[3, i],
            turn * p[4, i],
            turn * p[5, i],
            least_m * scale,
            scale,
            bits,
            np.int32(i),
            x,
            y,
            z,
            nx,
            ny,
            nz,
            back,
        )
        found[i] = key & mask
    for j in range(n_target):
        found_back[j] = back[j] & mask


@njit(cache=True, nogil=True, fastmath=FINITE)
def match_one(a, b, c, na, nb, nc, least, scale, bits, i, x, y, z, nx, ny, nz, back):
    """Key of the target pair nearest to source pair i; lowers the keys in `back` of those that i is nearest to."""
    nearest = np.int32(2147483647)
    for j in range(len(back)):
        dx, dy, dz = x[j] - a, y[j] - b, z[j] - c
        cost = np.sqrt(dx * dx + dy * dy + dz * dz) * scale - (na * nx[j] + nb * ny[j] + nc * nz[j]) + least
        key = np.int32(np.int32(cost) << bits)
        nearest = min(nearest, np.int32(key | np.int32(j)))
        back[j] = min(back[j], np.int32(key | i))
    return nearest


@njit(cache=True, nogil=True)
def _distance(source, pose, lambda_m):
    pairs, match, match_back = pose.pairs, pose.match, pose.match_back
    forth, back = 0.0, 0.0
    for i in range(len(match)):
        forth += _cost(source, i, pairs, match[i], lambda_m)
    for j in range(len(match_back)):
        back += _cost(source, match_back[j], pairs, j, lambda_m)
    return forth / len(match) + back / len(match_back)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def distances(target, points, normals, lambda_m, u):
    """DCD (T,) of (T, m) configurations, each against its own frame of the source, m."""
    out = np.empty(len(u))
    source, pose = empty_source(points.shape[1]), empty_pose(target, points.shape[1])
    for t in range(len(u)):
        load_source(points[t], normals[t], source)
        out[t] = evaluate(target, source, lambda_m, u[t], pose)
    return out
