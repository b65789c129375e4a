"""A guess of an end-effector's YAML: how it opens and closes, which surfaces meet, how it is mounted."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment import Coupling, Embodiment, EndEffectorSpec, build_embodiment
from cei_gym.embodiment.meshes import geom_vertices
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding.digits import inside, rounded
from cei_gym.onboarding.fingers import Finger, find_fingers
from cei_gym.onboarding.mounting import guess_mount
from cei_gym.onboarding.padding import guess_pads
from cei_gym.onboarding.sides import choose_closing

_LARGEST_ROOT_M = 0.4  # of a fixed first link: what is larger is a stand


@dataclass(frozen=True)
class HandGuess:
    """What was found of an end-effector.

    Attributes:
        spec: its specification.
        embodiment: compiled from it.
        unsure: what to look at, by the YAML's field.
    """

    spec: EndEffectorSpec
    embodiment: Embodiment
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
    closing = choose_closing(embodiment, tree, groups)
    if any(not weight.any() for weight in closing.weights) or not closing.axis_base.any():
        raise CEIError(
            f"{spec.name}: no two of its links were found that close on each other; if they are there, write `closed` and `pads` yourself."
        )
    names = [embodiment.joint_names[q] for q in embodiment.coupled.independent]
    lower, upper = embodiment.independent_limits
    at = {label: inside(pose, lower, upper) for label, pose in (("home", closing.home), ("closed", closing.closed))}
    rest = embodiment.coupled.reduce(embodiment.home)
    home = {n: v for n, v, r in zip(names, at["home"], rest, strict=True) if v != r}
    closed = {n: v for n, v, h in zip(names, at["closed"], at["home"], strict=True) if v != h}
    position, quat_wxyz, snapped = guess_mount(embodiment, tree, closing, fingers)
    spec = replace(spec, home=home, closed=closed, mount_pos_m=position, mount_quat_wxyz=quat_wxyz)
    if not snapped:
        unsure["mount_quat_wxyz"] = "the way from palm to fingertips is along no axis of the first link"
    poses = (embodiment.coupled.expand(np.array(at[label])) for label in ("home", "closed"))
    embodiment = replace(embodiment, **dict(zip(("home", "closed"), poses, strict=True)))
    spec = replace(spec, pads=guess_pads(spec, embodiment, tree, closing))
    embodiment = build_embodiment(None, spec, folder)
    return HandGuess(spec, embodiment, unsure)


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
    return {names[1]: Coupling(names[0], scale, rounded(offset))}


def _tip(finger: Finger) -> Array:
    return np.append(finger.points_link.mean(axis=0), 1.0)
