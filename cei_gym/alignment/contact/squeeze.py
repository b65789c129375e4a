"""Grip force: how far a hand closes beyond the contact that was observed, or opens."""

import numpy as np

from cei_gym.alignment.contact.pads import opposing_sides
from cei_gym.alignment.problem import AlignmentProblem
from cei_gym.arrays import Array

_RIDGE = 1e-5  # m^2/rad^2: the least motion of joints among those that close the pads alike


def squeeze(problem: AlignmentProblem, u: Array, depth_m: Array, asymmetry: float = 0.0) -> Array:
    """Joints that close each pad along its normal, the arm at rest.

    Pads close in proportion to their share (their YAML's `share`), `depth_m` in the mean: a thumb against two fingers goes
    farther than each of them, so that it pushes as hard as both and the object stays where it is. Fingers whose joints give
    way (the YAML's `compliance`) are sent farther.

    Args:
        problem: the target.
        u: (T, m) independent joints, rad or m.
        depth_m: (T,) how far; less than 0 opens.
        asymmetry: from -1 to 1, by how much more of it pads do that are on the side of the first, and the others less.

    Returns:
        (T, m) independent joints, within limits.
    """
    embodiment, representation = problem.embodiment, problem.representation
    hand = np.flatnonzero(embodiment.coupled.independent >= embodiment.n_arm)
    closing = np.flatnonzero(depth_m)
    if not len(closing) or not len(hand):
        return u
    qpos = embodiment.coupled.expand(u[closing])
    _, normals = representation.place(problem.tree.forward(qpos))
    spec = embodiment.end_effector
    assert spec is not None  # it has pads
    pads = spec.pads
    share = np.array([pad.share for pad in pads])
    mean = share.mean()
    if asymmetry and (sides := opposing_sides(representation, problem.tree)) is not None:
        own = [sides[representation.body == embodiment.body_id(pad.body)][0] for pad in pads]
        share = share * (1 + asymmetry * np.where(np.array(own) == 0, 1.0, -1.0))
    hessian, gradient = _RIDGE * np.eye(len(hand)), 0.0
    for pad, weight in zip(pads, spec.compliance * share / mean, strict=True):
        own = representation.body == embodiment.body_id(pad.body)
        normal = normals[:, own].mean(axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        centre = representation.points_link[own].mean(axis=0)
        J = problem.tree.jacobian(qpos, embodiment.body_id(pad.body), centre)[:, :3] @ embodiment.coupled.A[:, hand]
        hessian = hessian + J.transpose(0, 2, 1) @ J
        gradient = gradient + np.einsum("tim,ti->tm", J, normal) * (weight * depth_m[closing])[:, None]
    lower, upper = embodiment.independent_limits
    out = u.copy()
    out[np.ix_(closing, hand)] += np.linalg.solve(hessian, np.asarray(gradient)[..., None])[..., 0]
    return np.clip(out, lower, upper)
