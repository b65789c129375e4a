"""A guess of an end-effector's YAML: how it opens and closes, which surfaces meet, how it is mounted."""

from dataclasses import dataclass, replace
from itertools import combinations, pairwise, product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.embodiment import Coupling, Embodiment, EndEffectorSpec, Pad, build_embodiment
from cei_gym.embodiment.meshes import collision_geoms, geom_vertices, outermost
from cei_gym.errors import CEIError
from cei_gym.functional.palmar import palmar_directions
from cei_gym.functional.representation import pad_mesh, sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding.closing import Closing, Judge, design, scan
from cei_gym.onboarding.fingers import Finger, find_fingers

_CURLED = 0.75  # of the way to their far limit, where fingers without a pad rest
_NEAR_TIP = 0.75
_LEADS = 0.9  # cosine to a pad's normal of the way that its link sets out, where that is told by the pose alone
_LEAST_RANGE = 1e-3
_TRIAL = 60  # rounds that tell which fingers oppose the thumb best
_FARTHER = 0.2  # what fingers must be better by, for each finger that they are farther from the thumb
_LARGEST_ROOT_M = 0.4  # of a fixed first link: what is larger is a stand
_SNAP_RAD = np.radians(25)  # within which a mount follows the axes of the first link
_DIGITS = 3


@dataclass(frozen=True)
class HandGuess:
    """What was found of an end-effector.

    Attributes:
        spec: its specification.
        embodiment: compiled from it.
        closing: how it closes.
        unsure: what to look at, by the YAML's field.
    """

    spec: EndEffectorSpec
    embodiment: Embodiment
    closing: Closing
    unsure: dict[str, str]


def guess_hand(spec: EndEffectorSpec, folder: Path) -> HandGuess:
    """Complete an end-effector's specification that has no pads yet.

    Args:
        spec: its name, description, root and joints.
        folder: that the description's path starts from.

    Raises:
        CEIError: its description is refused, or nothing of it closes on anything.
    """
    unsure: dict[str, str] = {}
    embodiment = build_embodiment(None, spec, folder)
    tree = KinematicTree(embodiment)
    if (stand := _stand(embodiment, tree)) is not None:
        left_out, root = stand
        spec = replace(spec, root_body=root)
        unsure["root_body"] = f"{left_out!r} before it is over {_LARGEST_ROOT_M:g} m long, a stand rather than a part"
        embodiment = build_embodiment(None, spec, folder)
        tree = KinematicTree(embodiment)
    groups = find_fingers(embodiment, tree)
    fingers = [group[0] for group in groups]
    if len(fingers) < 2:
        raise CEIError(
            f"{spec.name}: {len(fingers)} of its links end a finger and have a shape that can touch; two must, to hold something."
        )
    if (mirrored := _mirrored(embodiment, tree, fingers)) is not None:
        spec = replace(spec, couplings={**spec.couplings, **mirrored})
        unsure["couplings"] = "nothing says that its two fingers move together; most grippers' do"
        embodiment = build_embodiment(None, spec, folder)
        tree = KinematicTree(embodiment)
        groups = find_fingers(embodiment, tree)
        fingers = [group[0] for group in groups]
    closing = _closing(embodiment, tree, groups)
    names = [embodiment.joint_names[q] for q in embodiment.coupled.independent]
    lower, upper = embodiment.independent_limits
    at = {label: _inside(pose, lower, upper) for label, pose in (("home", closing.home), ("closed", closing.closed))}
    rest = embodiment.coupled.reduce(embodiment.home)
    home = {n: v for n, v, r in zip(names, at["home"], rest, strict=True) if v != r}
    closed = {n: v for n, v, h in zip(names, at["closed"], at["home"], strict=True) if v != h}
    position, quat_wxyz, snapped = _mount(embodiment, tree, closing, fingers)
    spec = replace(spec, home=home, closed=closed, mount_pos_m=position, mount_quat_wxyz=quat_wxyz)
    if not snapped:
        unsure["mount_quat_wxyz"] = "the way from palm to fingertips is along no axis of the first link"
    poses = (embodiment.coupled.expand(np.array(at[label])) for label in ("home", "closed"))
    embodiment = replace(embodiment, **dict(zip(("home", "closed"), poses, strict=True)))
    spec = replace(spec, pads=_pads(spec, embodiment, tree, closing))
    embodiment = build_embodiment(None, spec, folder)
    return HandGuess(spec, embodiment, closing, unsure)


def _round(value: float) -> float:
    return round(float(value), _DIGITS) + 0.0


def _stand(embodiment: Embodiment, tree: KinematicTree) -> tuple[str, str] | None:
    """A large fixed link that comes before the hand, and the link after it."""
    model = embodiment.model
    for body in range(1, model.nbody):
        geoms = np.flatnonzero(model.geom_bodyid == body)
        if tree.arrays.body_joint[body] >= 0 or not len(geoms):
            continue
        extents = np.ptp(np.concatenate([geom_vertices(model, geom) for geom in geoms]), axis=0)
        after = [b for b in np.flatnonzero(tree.arrays.parent == body) if b]
        if extents.max() > _LARGEST_ROOT_M and len(after) == 1:
            return embodiment.link_names[body], embodiment.link_names[int(after[0])]
    return None


def _inside(pose: Array, lower: Array, upper: Array) -> list[float]:
    """Joint positions in few digits that are within limits."""
    step = 10.0**-_DIGITS
    low, high = np.ceil(lower / step - 1e-6) * step, np.floor(upper / step + 1e-6) * step
    return [_round(v) for v in np.where(low <= high, np.clip(np.round(pose / step) * step, low, high), pose)]


def _mirrored(embodiment: Embodiment, tree: KinematicTree, fingers: list[Finger]) -> dict[str, Coupling] | None:
    """A coupling of the two joints of a gripper whose fingers have one each, alike."""
    moved = {finger.joints for finger in fingers}
    if len(embodiment.coupled.independent) != 2 or moved != {(0,), (1,)}:
        return None
    lower, upper = embodiment.independent_limits
    span = upper - lower
    if not np.isclose(*span, rtol=0.05):
        # Limits of one that its description leaves wide do not tell.
        span = np.repeat(span.min(), 2)
    fingers = [next(finger for finger in fingers if finger.joints == (u,)) for u in (0, 1)]
    rest = embodiment.coupled.reduce(embodiment.home)
    ways = []
    for sign in (1.0, -1.0):
        u = np.stack([rest, rest + 0.05 * span * [1.0, sign]])
        T = tree.forward(embodiment.coupled.expand(u))
        moves = [T[1, f.body] @ _tip(f) - T[0, f.body] @ _tip(f) for f in fingers]
        ways.append((float(np.dot(moves[0][:3], moves[1][:3])), sign))
    scale = min(ways)[1]  # fingers that close go towards each other
    names = [embodiment.joint_names[q] for q in embodiment.coupled.independent]
    offset = lower[1] - lower[0] if scale > 0 else upper[1] + lower[0]
    return {names[1]: Coupling(names[0], scale, _round(offset))}


def _tip(finger: Finger) -> Array:
    return np.append(finger.points_link.mean(axis=0), 1.0)


def _closing(embodiment: Embodiment, tree: KinematicTree, groups: list[list[Finger]]) -> Closing:
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
    ahead = _pointing(embodiment, tree, [finger for finger in fingers if finger.joints])
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
    anchors = np.array([_anchor(embodiment, tree, finger) for finger in fingers])
    spread = anchors - anchors.mean(axis=0)
    along = spread @ np.linalg.svd(spread, full_matrices=False)[2][0]
    row = [fingers[i] for i in along.argsort()]
    far_m = np.linalg.norm(anchors[along.argsort()] - _anchor(embodiment, tree, thumb), axis=1)
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
        body = int(np.searchsorted(tree.arrays.joint_start, joint, side="right")) - 1
        axes.append(T_links[body, :3, :3] @ tree.arrays.axis[joint])
    alike = np.abs(np.array(axes) @ np.array(axes).T).sum(axis=1)
    return [fingers[int(alike.argmin())]]


def _anchor(embodiment: Embodiment, tree: KinematicTree, finger: Finger) -> Array:
    """(3,) where a finger's first own joint is, m."""
    body = int(np.searchsorted(tree.arrays.joint_start, finger.first_joint, side="right")) - 1
    return tree.forward(embodiment.home)[body, :3, 3]


def _others(
    embodiment: Embodiment, tree: KinematicTree, rest: Array, fingers: tuple[Finger, ...]
) -> tuple[Array, Array]:
    """(V, 3) outermost points of all that the fingers' ends are not and their joints do not move, and (3,) the middle of where fingers begin, m."""
    T_links = tree.forward(embodiment.coupled.expand(rest))
    used = {u for finger in fingers for u in finger.joints}
    kept = []
    for body in range(1, embodiment.model.nbody):
        joint, moved = tree.arrays.body_joint[body], False
        while joint >= 0:
            moved |= int(embodiment.coupled.leader[joint]) in used
            joint = tree.arrays.joint_parent[joint]
        geoms = collision_geoms(embodiment.model, body)
        if moved or not len(geoms) or any(finger.body == body for finger in fingers):
            continue
        vertices = outermost(np.concatenate([geom_vertices(embodiment.model, geom) for geom in geoms]))
        kept.append(vertices @ T_links[body, :3, :3].T + T_links[body, :3, 3])
    if not kept:
        kept = [T_links[1, None, :3, 3]]
    bases = np.array([_anchor(embodiment, tree, finger) for finger in fingers if finger.joints])
    return np.concatenate(kept), (bases.min(axis=0) + bases.max(axis=0)) / 2


def _mount(
    embodiment: Embodiment, tree: KinematicTree, closing: Closing, fingers: list[Finger]
) -> tuple[list[float], list[float], bool]:
    """Where the first link is on a flange whose z points out of the arm: fingertips ahead, y across the fingers."""
    home = tree.forward(embodiment.coupled.expand(closing.home))
    root = embodiment.end_effector_root
    R_base_root, origin = home[root, :3, :3], home[root, :3, 3]
    geoms = [g for body in _fixed_to_root(tree, root) for g in collision_geoms(embodiment.model, body)]
    vertices = [
        geom_vertices(embodiment.model, g) @ home[embodiment.model.geom_bodyid[g], :3, :3].T
        + home[embodiment.model.geom_bodyid[g], :3, 3]
        for g in geoms
    ]
    own = (np.concatenate(vertices) if vertices else origin[None]) - origin
    own = own @ R_base_root  # in the first link's frame
    across = R_base_root.T @ closing.axis_base
    ahead = R_base_root.T @ _pointing(
        embodiment, tree, [f for f in fingers if f.joints and (len(fingers) < 4 or f not in closing.sides[0])]
    )
    z, snapped = _snapped(ahead)
    y, _ = _snapped(across - (across @ z) * z)
    y = y - (y @ z) * z
    y /= np.linalg.norm(y)
    R_flange_root = np.stack([np.cross(y, z), y, z])
    placed = own @ R_flange_root.T
    middle = (placed.min(axis=0) + placed.max(axis=0)) / 2
    # A first link's frame is on its axis, unless it is beside all of it.
    shift = np.where((placed.min(axis=0) <= 0) & (placed.max(axis=0) >= 0), 0.0, -middle)
    shift[2] = -placed[:, 2].min()
    quat = Rotation.from_matrix(R_flange_root).as_quat(scalar_first=True)
    quat *= np.sign(quat[np.abs(quat).argmax()])
    return [_round(x) for x in shift], [round(float(x), 6) + 0.0 for x in quat], snapped


def _pointing(embodiment: Embodiment, tree: KinematicTree, fingers: list[Finger]) -> Array:
    """(3,) where stretched fingers point, in the base frame."""
    T_links = tree.forward(embodiment.coupled.expand(_neutral(embodiment)))
    ways = []
    for finger in fingers:
        T = T_links[finger.body]
        way = finger.points_link @ T[:3, :3].T + T[:3, 3] - _anchor(embodiment, tree, finger)
        farthest = way[np.linalg.norm(way, axis=1).argsort()[-len(way) // 5 :]].mean(axis=0)
        ways.append(farthest / np.linalg.norm(farthest))
    return np.sum(ways, axis=0)


def _neutral(embodiment: Embodiment) -> Array:
    """(m,) 0, or the nearest that limits allow."""
    return np.clip(np.zeros(len(embodiment.coupled.independent)), *embodiment.independent_limits)


def _fixed_to_root(tree: KinematicTree, root: int) -> list[int]:
    own = tree.arrays.body_joint[root]
    return [body for body in range(root, len(tree.arrays.parent)) if tree.arrays.body_joint[body] == own]


def _snapped(direction: Array) -> tuple[Array, bool]:
    unit = direction / np.linalg.norm(direction)
    axis = np.zeros(3)
    axis[np.abs(unit).argmax()] = np.sign(unit[np.abs(unit).argmax()])
    return (axis, True) if unit @ axis > np.cos(_SNAP_RAD) else (unit, False)


def _pads(spec: EndEffectorSpec, embodiment: Embodiment, tree: KinematicTree, closing: Closing) -> list[Pad]:
    """Pads that can be sampled: of each link the part that can oppose."""
    one, two = closing.sides
    most = max(len(one), len(two))
    pads = []
    for side in closing.sides:
        for finger in side:
            weight = closing.weights[closing.fingers.index(finger)]
            jaws = len(closing.fingers) == 2 and len({f.joints for f in closing.fingers if f.joints}) == 1
            extent = _extent(embodiment, finger, weight) if jaws else [0.0, 1.0]
            pad = Pad(body=finger.link, share=most / len(side), extent=extent)
            normal = (weight[:, None] * finger.normals_link).sum(axis=0)
            normal /= np.linalg.norm(normal)
            if not finger.joints or _auto(embodiment, tree, pad, finger, weight) @ normal < _LEADS:
                pad = replace(pad, palmar=[_round(x) for x in _snapped(normal)[0]])
            pads.append(_sampled(spec, embodiment, pad))
    return pads


def _auto(embodiment: Embodiment, tree: KinematicTree, pad: Pad, finger: Finger, weight: Array) -> Array:
    """(3,) the palmar direction that is found where a YAML gives none."""
    return palmar_directions(embodiment, tree, pad, (weight @ finger.points_link / weight.sum())[None])[0]


def _extent(embodiment: Embodiment, finger: Finger, weight: Array) -> list[float]:
    """Which part of a link's length, to its tip, holds objects."""
    mesh = pad_mesh(embodiment, Pad(body=finger.link))
    _, _, axes = np.linalg.svd(mesh.vertices - mesh.vertices.mean(0), full_matrices=False)
    along = np.asarray(mesh.vertices) @ axes[0]
    points = finger.points_link[weight > 0.3 * weight.max()] @ axes[0]
    if -along.min() > along.max():
        along, points = -along, -points
    ends = (np.quantile(points, [0.02, 0.98]) - along.min()) / np.ptp(along)
    start, end = np.clip(np.round(ends, 2), 0, 1)
    start, end = 0.0 if start < 1 - _NEAR_TIP and finger.joints else start, 1.0 if end > _NEAR_TIP else end
    return [float(start), float(end)] if end > start else [0.0, 1.0]


def _sampled(spec: EndEffectorSpec, embodiment: Embodiment, pad: Pad) -> Pad:
    """A pad with the largest `palmar_cosine` that leaves it a surface."""
    for cosine in (pad.palmar_cosine, 0.6, 0.4):
        tried = replace(pad, palmar_cosine=cosine)
        one = replace(spec, pads=[tried])
        try:
            sample_representation(replace(embodiment, end_effector=one), 16)
        except CEIError:
            continue
        return tried
    return pad
