"""Which shapes of a composed robot touch each other: by its YAMLs' `self_contact`."""

from itertools import combinations

import mujoco
import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment


def touching_geoms(embodiment: Embodiment) -> list[tuple[str, str]]:
    """Pairs of geoms of an embodiment's model that touch each other in a simulation, by name.

    Links that are fixed to each other, neighbours across a joint, those that the description excludes, and pairs that overlap at home are
    none of them.
    """
    parts = (embodiment.arm, embodiment.end_effector)
    of_arm, of_hand = ("none" if part is None else part.self_contact for part in parts)
    if of_arm == of_hand == "none":
        return []
    model, data, hand, finger = (
        embodiment.model,
        mujoco.MjData(embodiment.model),
        embodiment.of_end_effector,
        _fingers(embodiment),
    )
    data.qpos[:] = embodiment.home
    mujoco.mj_kinematics(model, data)
    excluded = {(int(pair) >> 16, int(pair) & 0xFFFF) for pair in model.exclude_signature}
    found: list[tuple[str, str]] = []
    for one, other in combinations(np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist(), 2):
        link, beside = model.geom_bodyid[one], model.geom_bodyid[other]
        if {(link, beside), (beside, link)} & excluded or _are_neighbours(model, link, beside):
            continue
        if hand[link] and hand[beside]:
            touch = of_hand == "all" or (of_hand == "fingers" and 0 < finger[link] != finger[beside] > 0)
        else:
            touch = of_arm == "all" and (of_hand == "all" or not (hand[link] or hand[beside]))
        if touch and mujoco.mj_geomDistance(model, data, one, other, 1.0, None) > 0:
            found.append((model.geom(one).name, model.geom(other).name))
    return found


def _are_neighbours(model: mujoco.MjModel, one: int, other: int) -> bool:
    """Whether links are fixed to each other, or one moves on the other."""
    group, parent = model.body_weldid, model.body_parentid
    mine, theirs = group[one], group[other]
    return mine in (theirs, group[parent[theirs]]) or theirs == group[parent[mine]]


def _fingers(embodiment: Embodiment) -> Array:
    """(B,) the first link of the finger that a body belongs to, which moves on the palm; 0 of all that does not."""
    model, palm = embodiment.model, embodiment.model.body_weldid[embodiment.end_effector_root]
    finger = np.zeros(model.nbody, int)
    for body in np.flatnonzero(embodiment.of_end_effector):
        parent, group = model.body_parentid[body], model.body_weldid[body]
        if group != palm:
            finger[body] = finger[parent] or body
    return finger
