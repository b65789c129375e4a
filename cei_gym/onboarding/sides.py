"""Which fingers close on each other, and how."""

from itertools import combinations, pairwise, product

import numpy as np

from cei_gym.alignment.links import link_shapes
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding.closing import Closing, Judge
from cei_gym.onboarding.fingers import Finger, anchor, pointing
from cei_gym.onboarding.search import design, scan

_CURLED = 0.75  # of the way to their far limit, where fingers without a pad rest
_LEAST_RANGE = 1e-3
_TRIAL = 60  # rounds that tell which fingers oppose the thumb best
_FARTHER = 0.2  # what fingers must be better by, for each finger that they are farther from the thumb


def choose_closing(embodiment: Embodiment, tree: KinematicTree, groups: list[list[Finger]]) -> Closing:
    """The best way to close that an end-effector has.

    Args:
        embodiment: an end-effector.
        tree: its kinematics.
        groups: of `find_fingers`.

    Raises:
        CEIError: nothing that ends a finger can move.
    """
    fingers = [group[0] for group in groups]
    rest = embodiment.coupled.reduce(embodiment.home)
    joints = sorted({u for finger in fingers for u in finger.joints})
    lower, upper = embodiment.independent_limits
    if all(finger.joints == fingers[0].joints for finger in fingers if finger.joints) and len(fingers[0].joints) == 1:
        found = []
        every = [finger for group in groups for finger in group]
        for pair in (pair for two in combinations(groups, 2) for pair in product(*two)):
            if any(finger.joints for finger in pair):
                judge = Judge(embodiment, tree, ((pair[0],), (pair[1],)), *_others(embodiment, tree, rest, pair))
                closing = scan(judge, embodiment, rest, joints[0])
                found.append((closing.cost + _overtaken(embodiment, tree, closing, every), closing))
        return min(found, key=lambda each: each[0])[1]
    thumbs = [finger for finger in fingers if finger.named_thumb] or _odd(embodiment, tree, fingers)
    tried = []
    for thumb in thumbs:
        others = [finger for finger in fingers if finger is not thumb]
        for away, against in enumerate(_neighbours(embodiment, tree, thumb, others)):
            sides = ((thumb,), against)
            used = sorted({u for finger in (thumb, *against) for u in finger.joints})
            curled = rest.copy()
            for u in {u for finger in others for u in finger.joints} - set(used):
                curled[u] = _curled(lower[u], upper[u])
            active = np.array([u for u in used if upper[u] - lower[u] > _LEAST_RANGE])
            if not len(active):
                continue
            judge = Judge(embodiment, tree, sides, *_others(embodiment, tree, curled, sides[0] + sides[1]))
            cost = design(judge, embodiment, curled, active, rounds=_TRIAL).cost + _FARTHER * away
            tried.append((cost, judge, curled, active))
    if not tried:
        raise CEIError(
            f"{embodiment.name}: none of its fingers' joints has room to move; say how they follow each other under `couplings`."
        )
    _, judge, curled, active = min(tried, key=lambda each: each[0])
    return design(judge, embodiment, curled, active)


def _overtaken(embodiment: Embodiment, tree: KinematicTree, closing: Closing, fingers: list[Finger]) -> float:
    """How far other ends reach beyond those that close, as linkages have them, in units of 1 cm."""
    u = (1 - closing.share) * closing.home + closing.share * closing.closed
    T_links = tree.forward(embodiment.coupled.expand(u))
    ahead = pointing(embodiment, tree, [finger for finger in fingers if finger.joints])
    ahead /= np.linalg.norm(ahead)
    far = {
        f.link: (f.points_link @ T_links[f.body, :3, :3].T + T_links[f.body, :3, 3]) @ ahead
        for f in fingers
        if f.joints
    }
    own = max(far[f.link].max() for f in closing.fingers if f.joints)
    return float(max(height.max() for height in far.values()) - own) / 0.01


def _neighbours(
    embodiment: Embodiment, tree: KinematicTree, thumb: Finger, fingers: list[Finger]
) -> list[tuple[Finger, ...]]:
    """Each two of some fingers that are next to each other, or the one there is; those next to the thumb first."""
    anchors = np.array([anchor(embodiment, tree, finger) for finger in fingers])
    spread = anchors - anchors.mean(axis=0)
    along = spread @ np.linalg.svd(spread, full_matrices=False)[2][0]
    row = [fingers[i] for i in along.argsort()]
    far_m = np.linalg.norm(anchors[along.argsort()] - anchor(embodiment, tree, thumb), axis=1)
    row = row[::-1] if far_m[0] > far_m[-1] else row
    return list(pairwise(row)) or [tuple(row)]


def _curled(lower: float, upper: float) -> float:
    """A joint that goes about as far to either side spreads fingers; another curls them."""
    if min(-lower, upper) > 0.5 * max(-lower, upper):
        return 0.0
    far = upper if upper >= -lower else lower
    return _CURLED * far


def _odd(embodiment: Embodiment, tree: KinematicTree, fingers: list[Finger]) -> list[Finger]:
    """Who may be the thumb where none is called so: of many, the one whose last joint turns unlike the others'; of three, each."""
    if len(fingers) <= 3:
        return fingers
    axes = []
    T_links = tree.forward(embodiment.home)
    for finger in fingers:
        joint = tree.arrays.body_joint[finger.body]
        body = embodiment.model.jnt_bodyid[joint]
        axes.append(T_links[body, :3, :3] @ tree.arrays.axis[joint])
    alike = np.abs(np.array(axes) @ np.array(axes).T).sum(axis=1)
    return [fingers[int(alike.argmin())]]


def _others(
    embodiment: Embodiment, tree: KinematicTree, rest: Array, fingers: tuple[Finger, ...]
) -> tuple[Array, Array]:
    """(V, 3) outermost points of all that the fingers' ends are not and their joints do not move, and (3,) the middle of where fingers begin, m."""
    T_links = tree.forward(embodiment.coupled.expand(rest))
    used = {u for finger in fingers for u in finger.joints}
    shapes, leader, kept = link_shapes(embodiment), embodiment.coupled.leader, []
    for body, vertices in zip(shapes.body, shapes.vertices_link, strict=True):
        moved = used & set(leader[tree.moving(np.array([body]))].tolist())
        if not moved and all(finger.body != body for finger in fingers):
            kept.append(vertices @ T_links[body, :3, :3].T + T_links[body, :3, 3])
    if not kept:
        kept = [T_links[1, None, :3, 3]]
    bases = np.array([anchor(embodiment, tree, finger) for finger in fingers if finger.joints])
    return np.concatenate(kept), (bases.min(axis=0) + bases.max(axis=0)) / 2
