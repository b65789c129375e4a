"""Clearance as a part of the objective: links stay above the support surface, idle fingers out of objects.

A link is convex here: its outermost vertices for a plane, and their extent along fixed directions for points. Both are a
few multiplications a link, need no collision library inside compiled code, and are within 2 mm of the meshes against a plane.
Spheres fitted to links would be centimetres off at a palm's corners.
"""

from typing import NamedTuple

import numpy as np

from cei_gym.alignment.kernels.distance import place_joints
from cei_gym.alignment.kernels.quadratic import add_contact
from cei_gym.alignment.kernels.target import empty_pose
from cei_gym.arrays import Array
from cei_gym.compiled import njit


class Obstacles(NamedTuple):
    """Points on objects over T frames.

    Attributes:
        points: (P, 3) of all frames, base frame, m.
        start: (T + 1,) those of frame t are `points[start[t] : start[t + 1]]`.
    """

    points: Array
    start: Array


@njit(cache=True, nogil=True)
def at_frame(obstacles, t):
    """(P', 3) the points of one frame."""
    return obstacles.points[obstacles.start[t] : obstacles.start[t + 1]]


class CollisionConstraint(NamedTuple):
    """Links, and what they stay clear of, in the target's base frame.

    Attributes:
        weight: k of (k / 2) h^2 for a clearance that lacks h metres, 1/m; 0 switches all of it off.
        height_m: of the support surface.
        body: (K,) index of each link.
        joint: (K,) joint whose frame carries each link.
        margin_m: (K,) clearance wanted of each link.
        start: (K + 1,) vertices of link k are `start[k] : start[k + 1]`.
        vertices: (V, 3) outermost vertices in their joint's frame.
        directions: (D, 3) unit directions in the joint's frame.
        reach: (K, D) farthest that a link extends along each.
        centre, radius: (K, 3), (K,) a ball around each link, in the joint's frame.
        idle: (K,) links that keep out of objects too (idle fingers; while refining a grasp, also others).
    """

    weight: float
    height_m: float
    body: Array
    joint: Array
    margin_m: Array
    start: Array
    vertices: Array
    directions: Array
    reach: Array
    centre: Array
    radius: Array
    idle: Array


@njit(cache=True, nogil=True)
def penalise(collision, obstacles, origin, pose, quadratic, derivatives):
    """Sum of (k / 2) h^2 over links; adds its forces and blocks to `quadratic` if `derivatives`.

    Args:
        obstacles: (P, 3) points on objects, base frame.
    """
    total = 0.0
    point, normal = np.empty(3), np.empty(3)
    for link in range(len(collision.joint)):
        k = collision.joint[link]
        lacking = collision.height_m + collision.margin_m[link] - _lowest(collision, link, pose, k, point)
        if lacking > 0.0:
            total += 0.5 * collision.weight * lacking * lacking
            if derivatives:
                normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
                _about(point, origin)
                add_contact(k, point, normal, lacking, collision.weight, quadratic)
        if collision.idle[link]:
            margin = collision.margin_m[link]
            lacking = margin - nearest(collision, link, obstacles, pose, k, margin, point, normal)
            if lacking > 0.0:
                total += 0.5 * collision.weight * lacking * lacking
                if derivatives:
                    _about(point, origin)
                    add_contact(k, point, normal, lacking, collision.weight, quadratic)
    return total


@njit(cache=True, nogil=True)
def _about(point, origin):
    for i in range(3):
        point[i] -= origin[i]


@njit(cache=True, nogil=True)
def _lowest(collision, link, pose, k, point):
    """Height of a link's lowest vertex, which goes to `point`."""
    R, t = pose.rot[k], pose.pos[k]
    lowest, which = np.inf, 0
    for v in range(collision.start[link], collision.start[link + 1]):
        x = collision.vertices[v]
        z = t[2] + R[2, 0] * x[0] + R[2, 1] * x[1] + R[2, 2] * x[2]
        if z < lowest:
            lowest, which = z, v
    x = collision.vertices[which]
    for i in range(3):
        point[i] = t[i] + R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2]
    return lowest


@njit(cache=True, nogil=True)
def nearest(collision, link, obstacles, pose, k, cutoff_m, point, normal):
    """Distance of the nearest obstacle (negative inside), its point, and the way out for the link.

    Points beyond `cutoff_m` are not looked at: where all are, it is returned, and `point` and `normal` are not filled.
    """
    R, t, centre = pose.rot[k], pose.pos[k], collision.centre[link]
    cx = t[0] + R[0, 0] * centre[0] + R[0, 1] * centre[1] + R[0, 2] * centre[2]
    cy = t[1] + R[1, 0] * centre[0] + R[1, 1] * centre[1] + R[1, 2] * centre[2]
    cz = t[2] + R[2, 0] * centre[0] + R[2, 1] * centre[1] + R[2, 2] * centre[2]
    bound = (collision.radius[link] + max(cutoff_m, 0.0)) ** 2
    least, which, side = cutoff_m, -1, 0
    for p in range(len(obstacles)):
        ox, oy, oz = obstacles[p, 0], obstacles[p, 1], obstacles[p, 2]
        if (ox - cx) * (ox - cx) + (oy - cy) * (oy - cy) + (oz - cz) * (oz - cz) > bound:
            continue
        dx, dy, dz = ox - t[0], oy - t[1], oz - t[2]
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        outside, face = -np.inf, 0
        for d in range(len(collision.directions)):
            n = collision.directions[d]
            distance = n[0] * x + n[1] * y + n[2] * z - collision.reach[link, d]
            if distance > outside:
                outside, face = distance, d
                if outside >= least:
                    break
        if outside < least:
            least, which, side = outside, p, face
    if which >= 0:
        n = collision.directions[side]
        for i in range(3):
            point[i] = obstacles[which, i]
            normal[i] = -(R[i, 0] * n[0] + R[i, 1] * n[1] + R[i, 2] * n[2])
    return least


@njit(cache=True, nogil=True)
def shortfall(target, collision, obstacles, u):
    """(T,) clearance that the worst link lacks at (T, m) configurations, m."""
    pose = empty_pose(target, 1)
    worst = np.zeros(len(u))
    point, normal = np.empty(3), np.empty(3)
    for t in range(len(u)):
        place_joints(target, u[t], pose)
        around = at_frame(obstacles, t)
        for link in range(len(collision.joint)):
            k, margin = collision.joint[link], collision.margin_m[link]
            worst[t] = max(worst[t], collision.height_m + margin - _lowest(collision, link, pose, k, point))
            if collision.idle[link]:
                worst[t] = max(worst[t], margin - nearest(collision, link, around, pose, k, margin, point, normal))
    return worst
