"""One frame of the grasp's refinement: contact points that oppose each other as the source's did, compiled.

A pad meets an object where its surface reaches farthest along the closing direction: so deep, and across in the middle of
what lies about as deep (a soft maximum over its outermost vertices), so that the point moves smoothly as the pad turns, and
the middle of a tilted pad is brought to the object rather than its edge.
"""

from typing import NamedTuple

import numpy as np

from cei_gym.alignment.contact.grip import SOFTNESS_M
from cei_gym.alignment.kernels.distance import place_joints
from cei_gym.alignment.kernels.frame import empty_memory
from cei_gym.alignment.kernels.keep_out import KeepOut, nearest, penalise
from cei_gym.alignment.kernels.quadratic import add_contact, project
from cei_gym.alignment.kernels.step import DAMPING, STIFFENED, eased, take_step
from cei_gym.alignment.kernels.target import empty_pose
from cei_gym.compiled import njit

_OPEN_M = 0.02  # this much wider than what it holds, a hand is open
_DAMPING_TRIES = 6


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

    joint: np.ndarray
    side: np.ndarray
    share: np.ndarray
    start: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    palm: int
    hand: np.ndarray
    opposition: float
    facing: float
    approach: float
    turning: float
    carrying: float
    posture: float
    iterations: int
    tolerance: float


class Grip(NamedTuple):
    """What the source's end-effector does, in the target's base frame; see `cei_gym.alignment.contact.grip.Grip`."""

    axis: np.ndarray
    contacts: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    held: np.ndarray
    reference: int


class Wish(NamedTuple):
    """What one frame should be like, and how much each wish weighs.

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

    axis: np.ndarray
    contacts: np.ndarray
    rotation: np.ndarray
    point: np.ndarray
    position: np.ndarray
    opposition: float
    across: float
    facing: float
    turning: float
    moving: float
    posture: np.ndarray


class Links(NamedTuple):
    """Links that keep clear of points: `away` of those in `around`, `pads` of those `elsewhere` than in the grip."""

    away: KeepOut
    pads: KeepOut
    around: np.ndarray
    elsewhere: np.ndarray


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
def _energy(target, grasp, links, wish, anchor, u, pose, points, quadratic, derivatives):
    """Energy at u, m; its forces and blocks to `quadratic` if `derivatives` (then `pose` and `points` are those of u).

    Pads of one side share the offset of their mean from the source's contact across the axis; along it each has its own.
    """
    axis, contacts = wish.axis, wish.contacts
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
            total += 0.5 * wish.across * mean[side, i] ** 2
    for p in range(len(grasp.joint)):
        k, side = grasp.joint[p], grasp.side[p]
        depth = 0.0
        for i in range(3):
            depth += axis[i] * (points[p, i] - contacts[side, i])
        total += 0.5 * wish.opposition * depth * depth
        # Pads face what they press on: without this, contact points may be met by curling up.
        sign = 1.0 if side == 0 else -1.0
        normal = pose.rot[k] @ grasp.normals[p]
        facing = sign * (normal[0] * axis[0] + normal[1] * axis[1] + normal[2] * axis[2])
        total += wish.facing * (1.0 - facing)
        if derivatives:
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                quadratic.force[k, 3 + i] += wish.facing * sign * (axis[a] * normal[b] - axis[b] * normal[a])
                for j in range(i, 3):
                    quadratic.block[k, 3 + i, 3 + j] += wish.facing * ((1.0 if i == j else 0.0) - normal[i] * normal[j])
            add_contact(k, points[p], axis, -depth, wish.opposition, quadratic)
            _add_offset(k, points[p], mean[side], wish.across * grasp.share[p], quadratic)
    total += _palm_energy(grasp, wish, pose, quadratic, derivatives)
    for k in range(len(u)):
        total += 0.5 * wish.posture[k] * (u[k] - anchor[k]) ** 2
    if links.away.weight > 0.0:
        origin = np.zeros(3)
        total += penalise(links.away, links.around, origin, pose, quadratic, derivatives)
        total += penalise(links.pads, links.elsewhere, origin, pose, quadratic, derivatives)
    return total


@njit(cache=True, nogil=True)
def _palm_energy(grasp, wish, pose, quadratic, derivatives):
    """Of the palm's distance from where it should be, m."""
    k = grasp.palm
    R, t = pose.rot[k], pose.pos[k]
    # how it is turned: half the sum of cross products of its axes, the sine of the angle about its axis
    turn = np.zeros(3)
    for j in range(3):
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            turn[i] += 0.5 * (wish.rotation[a, j] * R[b, j] - wish.rotation[b, j] * R[a, j])
    total = 0.5 * wish.turning * (turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    place = t + R @ wish.point
    offset = place - wish.position
    total += 0.5 * wish.moving * (offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
    if derivatives:
        for i in range(3):
            quadratic.force[k, 3 + i] += wish.turning * turn[i]
            quadratic.block[k, 3 + i, 3 + i] += wish.turning
        if wish.moving > 0.0:
            _add_offset(k, place, offset, wish.moving, quadratic)
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
def _solve(target, grasp, links, wish, anchor, lower, upper, memory, points, trial_points, u):
    """Minimise the energy from u (m,), in place, inside a box."""
    pose, trial, quadratic, new = memory.pose, memory.trial, memory.quadratic, memory.new
    energy = _energy(target, grasp, links, wish, anchor, u, pose, points, quadratic, False)
    damping = DAMPING
    for _ in range(grasp.iterations):
        _energy(target, grasp, links, wish, anchor, u, pose, points, quadratic, True)
        project(target, np.zeros(3), pose, quadratic)
        gradient, hessian = quadratic.gradient, quadratic.hessian
        for k in range(len(u)):
            gradient[k] += wish.posture[k] * (u[k] - anchor[k])
            hessian[k, k] += wish.posture[k]
        accepted = False
        for _ in range(_DAMPING_TRIES):
            fall = take_step(hessian, gradient, damping, lower, upper, u, new, memory.step)
            if 0.0 <= fall < grasp.tolerance:
                break
            energy_new = _energy(target, grasp, links, wish, anchor, new, trial, trial_points, quadratic, False)
            if energy_new < energy:
                u[:] = new
                energy, accepted = energy_new, True
                pose, trial = trial, pose
                points, trial_points = trial_points, points
                damping = eased(damping)
                break
            damping *= STIFFENED
        if not accepted:
            break
    return energy


@njit(cache=True, nogil=True)
def _middle(grasp, grip, t, pose, points):
    """The middle of the contact points in the palm's frame and in that of the source's end-effector, (3,) each."""
    middle = np.zeros(3)
    for p in range(len(grasp.joint)):
        middle += 0.5 * grasp.share[p] * points[p]
    in_palm = np.ascontiguousarray(pose.rot[grasp.palm].T) @ (middle - pose.pos[grasp.palm])
    return in_palm, np.ascontiguousarray(grip.rotation[t].T) @ (middle - grip.position[t])


@njit(cache=True, nogil=True)
def _width(grip, t):
    """How far apart the source's two sides are, m."""
    across = grip.contacts[t, 1] - grip.contacts[t, 0]
    return abs((across * grip.axis[t]).sum())


@njit(cache=True, nogil=True)
def _miss(grasp, axis, contacts, points):
    """How far the two sides' mean contact points (of `points`, (P, 3)) are from `contacts` (2, 3), at most, m."""
    mean = np.zeros((2, 3))
    for p in range(len(grasp.joint)):
        mean[grasp.side[p]] += grasp.share[p] * (points[p] - contacts[grasp.side[p]])
    return max(np.sqrt((mean[0] ** 2).sum()), np.sqrt((mean[1] ** 2).sum()))


@njit(cache=True, nogil=True)
def overlaps(target, away, pads, around, around_start, elsewhere, elsewhere_start, u):
    """(T,) how deep links are in points at (T, m) configurations, m, and (T,) which link is deepest; points as for `refine`."""
    pose = empty_pose(target, 1)
    deepest, which = np.zeros(len(u)), np.zeros(len(u), np.int64)
    point, normal = np.empty(3), np.empty(3)
    for t in range(len(u)):
        place_joints(target, u[t], pose)
        for links, points in (
            (away, around[around_start[t] : around_start[t + 1]]),
            (pads, elsewhere[elsewhere_start[t] : elsewhere_start[t + 1]]),
        ):
            for link in range(len(links.joint)):
                if links.idle[link]:
                    distance = nearest(links, link, points, pose, links.joint[link], 0.0, point, normal)
                    if -distance > deepest[t]:
                        deepest[t], which[t] = -distance, links.body[link]
    return deepest, which


@njit(cache=True, nogil=True)
def refine(target, grasp, away, pads, around, around_start, elsewhere, elsewhere_start, grip, dt_s, followed):
    """Refine a trajectory (T, m), frame by frame, each started from the last.

    Args:
        away: links that keep clear of `around`; pads: those that only keep clear of `elsewhere`, what is not gripped. Points
            (K, 3) of all frames in one array, frame t's between `start[t]` and `start[t + 1]`.
        grip: see `Grip`.
        dt_s: time between frames; 0 leaves speeds unlimited.

    Returns:
        (T, m) independent joints, and (T,) how far contact points are from the source's, m; while something is held, how
        far they were when it was taken.
    """
    frames, m = followed.shape
    out, errors = np.empty((frames, m)), np.zeros(frames)
    memory = empty_memory(target, 1)
    points, trial_points = np.empty((len(grasp.joint), 3)), np.empty((len(grasp.joint), 3))
    u, last, held, anchor = followed[0].copy(), followed[0].copy(), followed[0].copy(), followed[0].copy()
    lower, upper = target.lower.copy(), target.upper.copy()
    loose, tight = np.full(m, grasp.posture), np.full(m, grasp.posture)
    tight[grasp.hand] = grasp.opposition
    nowhere = np.zeros((0, 3))
    reference = grip.reference
    # the palm's turn in the source's end-effector, and a point of both: the middle of the contacts
    turned, point, carried, narrow = np.eye(3), np.zeros(3), np.zeros(3), 0.0
    if reference >= 0:
        # The relation between palm and source is that of the frame in which the source takes hold.
        u[:] = followed[reference]
        last[:] = u
        place_joints(target, u, memory.pose)
        wish = Wish(
            grip.axis[reference],
            grip.contacts[reference],
            memory.pose.rot[grasp.palm].copy(),
            np.zeros(3),
            np.zeros(3),
            grasp.opposition,
            grasp.opposition,
            grasp.facing,
            grasp.turning,
            0.0,
            loose,
        )
        links = Links(away, pads, nowhere, nowhere)
        _solve(target, grasp, links, wish, last, lower, upper, memory, points, trial_points, u)
        place_joints(target, u, memory.pose)
        turned = np.ascontiguousarray(grip.rotation[reference].T) @ memory.pose.rot[grasp.palm]
        contact_points(grasp, memory.pose, grip.axis[reference], points)
        point, carried = _middle(grasp, grip, reference, memory.pose, points)
        narrow = _width(grip, reference)
    u[:] = followed[0]
    since = -1
    for t in range(frames):
        if t == 0:
            anchor[:] = followed[0]
        else:
            # motion goes on as it was followed; what it was changed by stays
            for k in range(m):
                anchor[k] = last[k]
                u[k] = last[k] + followed[t, k] - followed[t - 1, k]
        for k in range(m):
            lower[k], upper[k] = target.lower[k], target.upper[k]
            if t and dt_s > 0.0:
                lower[k] = max(lower[k], last[k] - target.fastest[k] * dt_s)
                upper[k] = min(upper[k], last[k] + target.fastest[k] * dt_s)
            u[k] = min(max(u[k], lower[k]), upper[k])
        if reference >= 0:
            rotation = np.ascontiguousarray(grip.rotation[t]) @ turned
        else:
            place_joints(target, followed[t], memory.pose)
            rotation = memory.pose.rot[grasp.palm].copy()
        holding = grip.held[t] and since >= 0
        position = grip.position[t] + np.ascontiguousarray(grip.rotation[t]) @ carried
        opened = min(max((_width(grip, t) - narrow) / _OPEN_M, 0.0), 1.0) if reference >= 0 else 0.0
        if holding:
            for k in grasp.hand:
                anchor[k] = held[k]
        wish = Wish(
            grip.axis[t],
            grip.contacts[t],
            rotation,
            point,
            position,
            0.0 if holding else grasp.opposition,
            0.0 if holding else (1.0 - opened) * grasp.opposition,
            0.0 if holding else grasp.facing,
            grasp.carrying if holding else grasp.turning,
            grasp.opposition if holding else opened * grasp.approach,
            tight if holding else loose,
        )
        links = Links(
            away,
            pads,
            around[around_start[t] : around_start[t + 1]],
            elsewhere[elsewhere_start[t] : elsewhere_start[t + 1]],
        )
        _solve(target, grasp, links, wish, anchor, lower, upper, memory, points, trial_points, u)
        if holding:
            errors[t] = errors[t - 1]
        else:
            place_joints(target, u, memory.pose)
            contact_points(grasp, memory.pose, grip.axis[t], points)
            errors[t] = _miss(grasp, grip.axis[t], grip.contacts[t], points)
        last[:] = u
        out[t] = u
        if not grip.held[t]:
            since = -1
        elif since < 0:
            since = t
            held[:] = u
            # What is held stays where it is both in the palm and in the source's end-effector.
            point, carried = _middle(grasp, grip, t, memory.pose, points)
            narrow = _width(grip, t)
            turned = np.ascontiguousarray(grip.rotation[t].T) @ memory.pose.rot[grasp.palm]
    return out, errors
