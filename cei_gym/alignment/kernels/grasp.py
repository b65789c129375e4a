"""A grasp's refinement, frame by frame, compiled: contact points are brought where the source's are, and stay in the hand."""

from typing import NamedTuple

import numpy as np

from cei_gym.alignment.kernels.collision import at_frame
from cei_gym.alignment.kernels.contact import GraspTarget, Links, contact_points, grasp_energy
from cei_gym.alignment.kernels.distance import place_joints
from cei_gym.alignment.kernels.frame import Memory, empty_memory
from cei_gym.alignment.kernels.quadratic import project
from cei_gym.alignment.kernels.step import DAMPING, STIFFENED, eased, take_step
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


class GripFrame(NamedTuple):
    """One frame of it: (3,), (2, 3), (3,), (3, 3)."""

    axis: Array
    contacts: Array
    position: Array
    rotation: Array


class Course(NamedTuple):
    """What is carried on from frame to frame.

    Attributes:
        turned: (3, 3) the palm's rotation in the source's end-effector as it takes hold.
        point, carried: (3,) a point of both, the middle of the contacts, in the palm's frame and in that of the source's end-effector.
        narrow: (1,) how far apart the source's two sides are then, m.
        known: (1,) whether the above is.
        last: (m,) where the joints were.
        begun: (1,) whether they were anywhere.
        held: (m,) where they were as what is held was taken.
        holds: (1,) whether something was held.
    """

    turned: Array
    point: Array
    carried: Array
    narrow: Array
    known: Array
    last: Array
    begun: Array
    held: Array
    holds: Array


@njit(cache=True, nogil=True)
def new_course(m):
    """Of a target with m joints that has held nothing yet."""
    no = np.zeros((3, 1), np.bool_)
    return Course(np.eye(3), np.zeros(3), np.zeros(3), np.zeros(1), no[0], np.zeros(m), no[1], np.zeros(m), no[2])


class Scratch(NamedTuple):
    """Memory of a trajectory, so that its frames allocate little: of frames in general, and contact points (P, 3) twice."""

    frame: Memory
    points: Array
    trial_points: Array


@njit(cache=True, nogil=True)
def empty_scratch(target, grasp):
    """For one trajectory of a target."""
    pads = len(grasp.joint)
    return Scratch(empty_memory(target, 1), np.empty((pads, 3)), np.empty((pads, 3)))


@njit(cache=True, nogil=True)
def _solve(target, grasp, links, wanted, anchor, lower, upper, scratch, u):
    """Minimise the energy from u (m,), in place, inside a box."""
    memory, points, trial_points = scratch.frame, scratch.points, scratch.trial_points
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
def _middle(grasp, grip, pose, points):
    """The middle of the contact points in the palm's frame and in that of the source's end-effector, (3,) each."""
    middle = np.zeros(3)
    for p in range(len(grasp.joint)):
        middle += 0.5 * grasp.share[p] * points[p]
    in_palm = np.ascontiguousarray(pose.rot[grasp.palm].T) @ (middle - pose.pos[grasp.palm])
    return in_palm, np.ascontiguousarray(grip.rotation.T) @ (middle - grip.position)


@njit(cache=True, nogil=True)
def _width(grip):
    """How far apart the source's two sides are, m."""
    across = grip.contacts[1] - grip.contacts[0]
    return abs((across * grip.axis).sum())


@njit(cache=True, nogil=True)
def _relate(grasp, grip, pose, points, course):
    """Remember how palm and source are to each other, and the contacts' middle to both."""
    course.turned[:] = np.ascontiguousarray(grip.rotation.T) @ pose.rot[grasp.palm]
    course.point[:], course.carried[:] = _middle(grasp, grip, pose, points)
    course.narrow[0], course.known[0] = _width(grip), True


@njit(cache=True, nogil=True)
def _miss(grasp, axis, contacts, points):
    """How far the two sides' mean contact points (of `points`, (P, 3)) are from `contacts` (2, 3), at most, m."""
    mean = np.zeros((2, 3))
    for p in range(len(grasp.joint)):
        mean[grasp.side[p]] += grasp.share[p] * (points[p] - contacts[grasp.side[p]])
    return max(np.sqrt((mean[0] ** 2).sum()), np.sqrt((mean[1] ** 2).sum()))


@njit(cache=True, nogil=True)
def take_hold(target, grasp, away, pads, grip, followed, scratch, course):
    """Relate palm and source as they are where the source takes hold and the target is followed to `followed` (m,), objects left out; to `course`."""
    u, nowhere = followed.copy(), np.zeros((0, 3))
    pose = scratch.frame.pose
    place_joints(target, u, pose)
    wanted = GraspTarget(
        grip.axis,
        grip.contacts,
        pose.rot[grasp.palm].copy(),
        np.zeros(3),
        np.zeros(3),
        grasp.opposition,
        grasp.opposition,
        grasp.facing,
        grasp.turning,
        0.0,
        np.full(len(u), grasp.posture),
    )
    links = Links(away, pads, nowhere, nowhere)
    _solve(target, grasp, links, wanted, followed, target.lower, target.upper, scratch, u)
    place_joints(target, u, pose)
    contact_points(grasp, pose, grip.axis, scratch.points)
    _relate(grasp, grip, pose, scratch.points, course)


@njit(cache=True, nogil=True)
def refine_frame(target, grasp, links, grip, held, dt_s, before, followed, scratch, course):
    """One frame, started from the last one.

    Args:
        links: with the points of this frame.
        grip: what the source does in it.
        held: whether it holds something.
        dt_s: time since the last frame; 0 leaves speeds unlimited.
        before, followed: (m,) where it is followed to, in the last frame and in this one.
        course: goes on.

    Returns:
        (m,) independent joints, and how far contact points are from the source's, m; while something is held, 0.
    """
    m, pose, last = len(followed), scratch.frame.pose, course.last
    u, anchor, lower, upper = followed.copy(), followed.copy(), target.lower.copy(), target.upper.copy()
    if course.begun[0]:
        # motion goes on as it was followed; what it was changed by stays
        for k in range(m):
            anchor[k] = last[k]
            u[k] = last[k] + followed[k] - before[k]
            if dt_s > 0.0:
                lower[k] = max(lower[k], last[k] - target.fastest[k] * dt_s)
                upper[k] = min(upper[k], last[k] + target.fastest[k] * dt_s)
    for k in range(m):
        u[k] = min(max(u[k], lower[k]), upper[k])
    if course.known[0]:
        rotation = np.ascontiguousarray(grip.rotation) @ course.turned
        opened = min(max((_width(grip) - course.narrow[0]) / _OPEN_M, 0.0), 1.0)
    else:
        place_joints(target, followed, pose)
        rotation, opened = pose.rot[grasp.palm].copy(), 0.0
    holding = held and course.holds[0]
    posture = np.full(m, grasp.posture)
    if holding:
        for k in grasp.hand:
            anchor[k], posture[k] = course.held[k], grasp.opposition
    wanted = GraspTarget(
        grip.axis,
        grip.contacts,
        rotation,
        course.point.copy(),
        grip.position + np.ascontiguousarray(grip.rotation) @ course.carried,
        0.0 if holding else grasp.opposition,
        0.0 if holding else (1.0 - opened) * grasp.opposition,
        0.0 if holding else grasp.facing,
        grasp.carrying if holding else grasp.turning,
        grasp.opposition if holding else opened * grasp.approach,
        posture,
    )
    _solve(target, grasp, links, wanted, anchor, lower, upper, scratch, u)
    error = 0.0
    if not holding:
        place_joints(target, u, pose)
        contact_points(grasp, pose, grip.axis, scratch.points)
        error = _miss(grasp, grip.axis, grip.contacts, scratch.points)
        if held:
            # What is held stays where it is both in the palm and in the source's end-effector.
            course.held[:] = u
            _relate(grasp, grip, pose, scratch.points, course)
    last[:] = u
    course.begun[0], course.holds[0] = True, held
    return u, error


@njit(cache=True, nogil=True)
def refine(target, grasp, away, pads, around, elsewhere, grip, reference, dt_s, followed):
    """Refine a trajectory (T, m), frame by frame, each started from the last.

    Args:
        away: links that keep clear of `around`; pads: those that only keep clear of `elsewhere`, what is not gripped.
        grip: see `GripArrays`.
        reference: frame whose relation between palm and source is that of all until something is held; -1 for none.
        dt_s: time between frames; 0 leaves speeds unlimited.

    Returns:
        (T, m) independent joints, and (T,) how far contact points are from the source's, m; while something is held, how
        far they were when it was taken.
    """
    frames, m = followed.shape
    out, errors = np.empty((frames, m)), np.zeros(frames)
    scratch, course = empty_scratch(target, grasp), new_course(m)
    if reference >= 0:
        at = _frame(grip, reference)
        take_hold(target, grasp, away, pads, at, followed[reference], scratch, course)
    for t in range(frames):
        links = Links(away, pads, at_frame(around, t), at_frame(elsewhere, t))
        before = followed[max(t - 1, 0)]
        held, holding = grip.held[t], grip.held[t] and course.holds[0]
        out[t], error = refine_frame(
            target, grasp, links, _frame(grip, t), held, dt_s, before, followed[t], scratch, course
        )
        errors[t] = errors[t - 1] if holding else error
    return out, errors


@njit(cache=True, nogil=True)
def _frame(grip, t):
    """Frame t of it."""
    return GripFrame(grip.axis[t], grip.contacts[t], grip.position[t], grip.rotation[t])
