"""The pads of an end-effector, of the fingers that close on each other."""

from dataclasses import replace

import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment, EndEffectorSpec, Pad
from cei_gym.errors import CEIError
from cei_gym.functional.palmar import length_axis, palmar_directions
from cei_gym.functional.representation import pad_mesh, sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding.closing import Closing
from cei_gym.onboarding.digits import rounded
from cei_gym.onboarding.fingers import Finger
from cei_gym.onboarding.mounting import snapped

_NEAR_TIP = 0.75
_LONGEST_M = (
    0.03  # of a gripper's fingers: with longer pads a demonstration's cube was held by their lower ends, and slipped
)
_LEADS = 0.9  # cosine to a pad's normal of the way that its link sets out, where that is told by the pose alone


def guess_pads(spec: EndEffectorSpec, embodiment: Embodiment, tree: KinematicTree, closing: Closing) -> list[Pad]:
    """Pads that can be sampled: of each link the part that can oppose."""
    one, two = closing.sides
    most = max(len(one), len(two))
    pads = []
    for side in closing.sides:
        for finger in side:
            weight = closing.weights[closing.fingers.index(finger)]
            jaws = len(closing.fingers) == 2 and len({f.joints for f in closing.fingers if f.joints}) == 1
            extent = _extent(embodiment, finger, weight) if jaws else [0.0, 1.0]
            pad = Pad(body=finger.link, geoms=list(finger.geoms), share=most / len(side), extent=extent)
            normal = (weight[:, None] * finger.normals_link).sum(axis=0)
            normal /= np.linalg.norm(normal)
            if not finger.joints or _auto(embodiment, tree, pad, finger, weight) @ normal < _LEADS:
                pad = replace(pad, palmar=[rounded(x) for x in snapped(normal)[0]])
            pads.append(_sampled(spec, embodiment, pad))
    return pads


def _auto(embodiment: Embodiment, tree: KinematicTree, pad: Pad, finger: Finger, weight: Array) -> Array:
    """(3,) the palmar direction that is found where a YAML gives none."""
    return palmar_directions(embodiment, tree, pad, (weight @ finger.points_link / weight.sum())[None])[0]


def _extent(embodiment: Embodiment, finger: Finger, weight: Array) -> list[float]:
    """Which part of a link's length, to its tip, holds objects."""
    mesh = pad_mesh(embodiment, Pad(body=finger.link, geoms=list(finger.geoms)))
    axis, first_m, last_m = length_axis(mesh)
    points = finger.points_link[weight > 0.3 * weight.max()] @ axis
    least = 1 - _LONGEST_M / (last_m - first_m)  # where fingertips begin, of long jaws
    ends = (np.quantile(points, [0.02, 0.98]) - first_m) / (last_m - first_m)
    start, end = np.clip(np.round(ends, 2), 0, 1)
    start, end = 0.0 if start < 1 - _NEAR_TIP and finger.joints else start, 1.0 if end > _NEAR_TIP else end
    if end == 1.0 and finger.joints:
        start = max(start, round(least, 2))
    return [float(start), float(end)] if end > start else [0.0, 1.0]


def _sampled(spec: EndEffectorSpec, embodiment: Embodiment, pad: Pad) -> Pad:
    """A pad with the largest `palmar_cosine` that leaves it a surface."""
    whole = [0.0, 1.0]  # where either end of a link may be its tip
    for cosine, extent in [(c, e) for e in (pad.extent, whole) for c in (pad.palmar_cosine, 0.6, 0.4)]:
        tried = replace(pad, palmar_cosine=cosine, extent=extent)
        one = replace(spec, pads=[tried])
        try:
            sample_representation(replace(embodiment, end_effector=one), 16)
        except CEIError:
            continue
        return tried
    return pad
