"""A grasp's refinement, frame by frame, compiled: contact points are brought where the source's are, and stay in the hand."""

from typing import NamedTuple

import numpy as np

from cei_gym.alignment.kernels.collision import at_frame, nearest
from cei_gym.alignment.kernels.contact import GraspTarget, Links, contact_points, grasp_energy
from cei_gym.alignment.kernels.distance import place_joints
from cei_gym.alignment.kernels.frame import empty_memory
from cei_gym.alignment.kernels.quadratic import project
from cei_gym.alignment.kernels.step import DAMPING, STIFFENED, eased, take_step
from cei_gym.alignment.kernels.target import empty_pose
from cei_gym.arrays import Array
from cei_gym.compiled import njit

_OPEN_M = 0.02  # this much wider than what it holds, a hand is open
_DAMPING_TRIES = 6


class GripArrays(NamedTuple):
    """What the source's end-effector does, in the target's base frame; see `cei_gym.alignment.grip.Grip`."""

    axis: Array
    contacts: Array
    position: Array
    rotation: Array
    held: Array
    reference: int


@njit(cache=True, nogil=True)
def _solve(target, grasp, links, wanted, anchor, lower, upper, memory, points, trial_points, u):
    """Minimise the energy from u (m,), in place, inside a box."""
    pose, trial, quadratic, new = memory.pose, memory.trial, memory.quadratic, memory.new
    energy = grasp_energy(target, grasp, links, wanted, anchor, u, pose, points, quadratic, False)
    damping = DAMPING
    for _ in range(grasp.iterations):
        grasp_energy(target, grasp, links, wanted, anchor, u, pose, points, quadratic, True)
        project(target, np.zeros(3), pose, quadratic)
        gradient, hessian = quadratic.gradient, quadratic.hessian
        for k in range(len(u)):
            gradient[k] += wanted.posture[k] * (u[k] - anchor[k])
            hessian[k, k] += wanted.posture[k]
        accepted = False
        for _ in range(_DAMPING_TRIES):
            fall = take_step(hessian, gradient, damping, lower, upper, u, new, memory.step)
            if 0.0 <= fall < grasp.tolerance:
                break
            energy_new = grasp_energy(target, grasp, links, wanted, anchor, new, trial, trial_points, quadratic, False)
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
def overlaps(target, away, pads, around, elsewhere, u):
    """(T,) how deep links are in points at (T, m) configurations, m, and (T,) which link is deepest; points as for `refine`."""
    pose = empty_pose(target, 1)
    deepest, which = np.zeros(len(u)), np.zeros(len(u), np.int64)
    point, normal = np.empty(3), np.empty(3)
    for t in range(len(u)):
        place_joints(target, u[t], pose)
        for links, points in (
            (away, at_frame(around, t)),
            (pads, at_frame(elsewhere, t)),
        ):
            for link in range(len(links.joint)):
                if links.idle[link]:
                    distance = nearest(links, link, points, pose, links.joint[link], 0.0, point, normal)
                    if -distance > deepest[t]:
                        deepest[t], which[t] = -distance, links.body[link]
    return deepest, which


@njit(cache=True, nogil=True)
def refine(target, grasp, away, pads, around, elsewhere, grip, dt_s, followed):
    """Refine a trajectory (T, m), frame by frame, each started from the last.

    Args:
        away: links that keep clear of `around`; pads: those that only keep clear of `elsewhere`, what is not gripped.
        grip: see `GripArrays`.
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
        wanted = GraspTarget(
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
        _solve(target, grasp, links, wanted, last, lower, upper, memory, points, trial_points, u)
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
        wanted = GraspTarget(
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
            at_frame(around, t),
            at_frame(elsewhere, t),
        )
        _solve(target, grasp, links, wanted, anchor, lower, upper, memory, points, trial_points, u)
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
