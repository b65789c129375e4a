"""The energy of a grasp: contact points that oppose each other as the source's did, compiled.

A pad meets an object where its surface reaches farthest along the closing direction: so deep, and across in the middle of
what lies about as deep (a soft maximum over its outermost vertices), so that the point moves smoothly as the pad turns, and
the middle of a tilted pad is brought to the object rather than its edge.
"""

from typing import NamedTuple

import numpy as np

from cei_gym.alignment.kernels.collision import CollisionConstraint, penalise
from cei_gym.alignment.kernels.distance import place_joints
from cei_gym.alignment.kernels.quadratic import add_contact
from cei_gym.arrays import Array
from cei_gym.compiled import njit

SOFTNESS_M = 1e-2
"""How deep below the farthest a vertex still counts for where, across, a pad touches."""


class Grasp(NamedTuple):
    """Pads that close against each other, and what their refinement weighs.

    Attributes:
        joint: (P,) joint whose frame carries each pad.
        side: (P,) 0 for pads that press along the source's closing axis, 1 for those against it.
        share: (P,) 1 / number of pads on its side.
        start: (P + 1,) vertices of pad p are `start[p] : start[p + 1]`.
        vertices: (V, 3) outermost vertices in their joint's frame, m.
        normals: (P, 3) unit mean normal of each pad in its joint's frame.
        palm: joint whose frame carries the end-effector's root.
        hand: independent joints of the end-effector.
        opposition, facing, approach, turning, carrying, posture: weights, see `ContactOptions`.
        iterations: most a frame.
        tolerance: fall of the energy that counts as none, m.
    """

    joint: Array
    side: Array
    share: Array
    start: Array
    vertices: Array
    normals: Array
    palm: int
    hand: Array
    opposition: float
    facing: float
    approach: float
    turning: float
    carrying: float
    posture: float
    iterations: int
    tolerance: float


class GraspTarget(NamedTuple):
    """What one frame should be like, and how much each part of it weighs.

    Attributes:
        axis: (3,) the source's closing axis.
        contacts: (2, 3) where its two sides meet the object.
        rotation: (3, 3) of the palm.
        point, position: (3,) a point in the palm's frame, and where it should be.
        opposition, across: weights of contacts along the axis and across it.
        facing: weight of pads facing each other along the axis.
        turning, moving: weights of the palm's rotation and of that point.
        posture: (m,) weights of staying near the anchor.
    """

    axis: Array
    contacts: Array
    rotation: Array
    point: Array
    position: Array
    opposition: float
    across: float
    facing: float
    turning: float
    moving: float
    posture: Array


class Links(NamedTuple):
    """Links that keep clear of points: `away` of those in `around`, `pads` of those `elsewhere` than in the grip."""

    away: CollisionConstraint
    pads: CollisionConstraint
    around: Array
    elsewhere: Array


@njit(cache=True, nogil=True)
def contact_points(grasp, pose, axis, points):
    """Fill `points` (P, 3): where each pad would meet an object, closing along `axis` (3,)."""
    for p in range(len(grasp.joint)):
        k = grasp.joint[p]
        R, t = pose.rot[k], pose.pos[k]
        sign = 1.0 if grasp.side[p] == 0 else -1.0
        ax = sign * (R[0, 0] * axis[0] + R[1, 0] * axis[1] + R[2, 0] * axis[2])
        ay = sign * (R[0, 1] * axis[0] + R[1, 1] * axis[1] + R[2, 1] * axis[2])
        az = sign * (R[0, 2] * axis[0] + R[1, 2] * axis[1] + R[2, 2] * axis[2])
        farthest = -np.inf
        for v in range(grasp.start[p], grasp.start[p + 1]):
            x = grasp.vertices[v]
            farthest = max(farthest, ax * x[0] + ay * x[1] + az * x[2])
        total, cx, cy, cz = 0.0, 0.0, 0.0, 0.0
        for v in range(grasp.start[p], grasp.start[p + 1]):
            x = grasp.vertices[v]
            depth = (farthest - ax * x[0] - ay * x[1] - az * x[2]) / SOFTNESS_M
            if depth < 8.0:
                w = np.exp(-depth)
                total += w
                cx += w * x[0]
                cy += w * x[1]
                cz += w * x[2]
        cx, cy, cz = cx / total, cy / total, cz / total
        short = farthest - (ax * cx + ay * cy + az * cz)
        cx, cy, cz = cx + short * ax, cy + short * ay, cz + short * az
        for i in range(3):
            points[p, i] = t[i] + R[i, 0] * cx + R[i, 1] * cy + R[i, 2] * cz


@njit(cache=True, nogil=True)
def grasp_energy(target, grasp, links, wanted, anchor, u, pose, points, quadratic, derivatives):
    """Energy at u, m; its forces and blocks to `quadratic` if `derivatives` (then `pose` and `points` are those of u).

    Pads of one side share the offset of their mean from the source's contact across the axis; along it each has its own.
    """
    axis, contacts = wanted.axis, wanted.contacts
    if derivatives:
        quadratic.force[:] = 0.0
        quadratic.block[:] = 0.0
    else:
        place_joints(target, u, pose)
        contact_points(grasp, pose, axis, points)
    total = 0.0
    mean = np.zeros((2, 3))
    for p in range(len(grasp.joint)):
        for i in range(3):
            mean[grasp.side[p], i] += grasp.share[p] * (points[p, i] - contacts[grasp.side[p], i])
    for side in range(2):
        along = mean[side, 0] * axis[0] + mean[side, 1] * axis[1] + mean[side, 2] * axis[2]
        for i in range(3):
            mean[side, i] -= along * axis[i]
            total += 0.5 * wanted.across * mean[side, i] ** 2
    for p in range(len(grasp.joint)):
        k, side = grasp.joint[p], grasp.side[p]
        depth = 0.0
        for i in range(3):
            depth += axis[i] * (points[p, i] - contacts[side, i])
        total += 0.5 * wanted.opposition * depth * depth
        # Pads face what they press on: without this, contact points may be met by curling up.
        sign = 1.0 if side == 0 else -1.0
        normal = pose.rot[k] @ grasp.normals[p]
        facing = sign * (normal[0] * axis[0] + normal[1] * axis[1] + normal[2] * axis[2])
        total += wanted.facing * (1.0 - facing)
        if derivatives:
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                quadratic.force[k, 3 + i] += wanted.facing * sign * (axis[a] * normal[b] - axis[b] * normal[a])
                for j in range(i, 3):
                    quadratic.block[k, 3 + i, 3 + j] += wanted.facing * (
                        (1.0 if i == j else 0.0) - normal[i] * normal[j]
                    )
            add_contact(k, points[p], axis, -depth, wanted.opposition, quadratic)
            _add_offset(k, points[p], mean[side], wanted.across * grasp.share[p], quadratic)
    total += _palm_energy(grasp, wanted, pose, quadratic, derivatives)
    for k in range(len(u)):
        total += 0.5 * wanted.posture[k] * (u[k] - anchor[k]) ** 2
    if links.away.weight > 0.0:
        origin = np.zeros(3)
        total += penalise(links.away, links.around, origin, pose, quadratic, derivatives)
        total += penalise(links.pads, links.elsewhere, origin, pose, quadratic, derivatives)
    return total


@njit(cache=True, nogil=True)
def _palm_energy(grasp, wanted, pose, quadratic, derivatives):
    """The energy of the palm's distance from where it should be, m."""
    k = grasp.palm
    R, t = pose.rot[k], pose.pos[k]
    # how it is turned: half the sum of cross products of its axes, the sine of the angle about its axis
    turn = np.zeros(3)
    for j in range(3):
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            turn[i] += 0.5 * (wanted.rotation[a, j] * R[b, j] - wanted.rotation[b, j] * R[a, j])
    total = 0.5 * wanted.turning * (turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    place = t + R @ wanted.point
    offset = place - wanted.position
    total += 0.5 * wanted.moving * (offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
    if derivatives:
        for i in range(3):
            quadratic.force[k, 3 + i] += wanted.turning * turn[i]
            quadratic.block[k, 3 + i, 3 + i] += wanted.turning
        if wanted.moving > 0.0:
            _add_offset(k, place, offset, wanted.moving, quadratic)
    return total


@njit(cache=True, nogil=True)
def _add_offset(joint, point, offset, weight, quadratic):
    """Add `(weight / 2) |offset|^2` for a point (3,) fixed to a joint's frame."""
    direction = np.zeros(3)
    for i in range(3):
        direction[:] = 0.0
        direction[i] = 1.0
        add_contact(joint, point, direction, -offset[i], weight, quadratic)


@njit(cache=True, nogil=True)
def in_grip(points, contacts, radius_m):
    """(P,) which of the points (P, 3) lie between two contacts (2, 3), within a radius of the line through them."""
    line = contacts[1] - contacts[0]
    length = np.sqrt((line**2).sum())
    touching = length < 1e-6
    if not touching:
        line /= length
    inside = np.empty(len(points), dtype=np.bool_)
    for n in range(len(points)):
        offset = points[n] - contacts[0]
        along = 0.0 if touching else (offset * line).sum()
        across = np.sqrt(((offset - along * line) ** 2).sum())
        inside[n] = across < radius_m and (touching or -radius_m < along < length + radius_m)
    return inside
