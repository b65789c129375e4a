"""A guess of an arm's YAML: its flange, and a rest pose above a table in front of it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.embodiment import ArmSpec, Embodiment, build_embodiment
from cei_gym.embodiment.meshes import geom_vertices
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding.digits import rounded
from cei_gym.onboarding.overlaps import Overlaps

_FRONT, _MOST_FRONT_M = 0.55, 0.5  # of the arm's reach, at most: how far in front the flange rests
_ABOVE, _MOST_ABOVE_M = 0.35, 0.3  # likewise above what it stands on
_BELOW_SHOULDER = 0.4  # likewise below a shoulder that is not near what it stands on, as of a humanoid
_STARTS, _POSES = 40, 2000
_MARGIN = 0.05  # of a joint's range that is kept to its limits
_OUTWARD = np.cos(np.radians(20))


@dataclass(frozen=True)
class ArmGuess:
    """What was found of an arm.

    Attributes:
        spec: its specification.
        embodiment: compiled from it.
        reach_m: from its first joint to its flange, stretched.
        unsure: what to look at, by the YAML's field.
    """

    spec: ArmSpec
    embodiment: Embodiment
    reach_m: float
    unsure: dict[str, str]


def guess_arm(spec: ArmSpec, folder: Path, T_mount_flange: Array | None = None) -> ArmGuess:
    """Complete an arm's specification that has neither a flange's pose nor a home yet.

    Args:
        spec: its name, description, joints and the flange's link.
        folder: that the description's path starts from.
        T_mount_flange: (4, 4) the flange in its link, where a hand in the same file tells; else it is found.

    Raises:
        CEIError: its description is refused.
    """
    unsure: dict[str, str] = {}
    embodiment = build_embodiment(spec, None, folder)
    tree = KinematicTree(embodiment)
    mount = embodiment.body_id(spec.mount_body)
    found, said = flange(embodiment, tree, mount)
    if T_mount_flange is None:
        T_mount_flange = found
        if said:
            unsure["mount_quat_wxyz"] = said
    if not np.allclose(T_mount_flange, np.eye(4)):  # to the micrometre: a hand of the same file is where it is
        quat = Rotation.from_matrix(T_mount_flange[:3, :3]).as_quat(scalar_first=True)
        position = [round(float(x), 6) + 0.0 for x in T_mount_flange[:3, 3]]
        spec = replace(spec, mount_pos_m=position, mount_quat_wxyz=[round(float(x), 6) + 0.0 for x in quat])
    reach = reach_m(embodiment)
    u, reached = _home(embodiment, tree, mount, T_mount_flange, reach)
    if not reached:
        unsure["home"] = "no pose was found whose flange points down in front of it; this is the nearest"
    names = [embodiment.joint_names[q] for q in embodiment.coupled.independent]
    spec = replace(spec, home=dict(zip(names, u, strict=True)))
    return ArmGuess(spec, build_embodiment(spec, None, folder), reach, unsure)


def flange(embodiment: Embodiment, tree: KinematicTree, mount: int) -> tuple[Array, str]:
    """(4, 4) a flange in its link whose z points out of the arm, and why it is not the link's own frame; "" if it is."""
    T = tree.forward(embodiment.home)
    joint = int(tree.arrays.body_joint[mount])
    holder = int(embodiment.model.jnt_bodyid[joint])
    anchor = T[holder, :3, :3] @ tree.arrays.anchor[joint] + T[holder, :3, 3]
    axis = T[holder, :3, :3] @ tree.arrays.axis[joint]
    before = T[tree.arrays.parent[holder], :3, 3]
    own = [g for g in range(embodiment.model.ngeom) if tree.arrays.body_joint[embodiment.model.geom_bodyid[g]] == joint]
    points = [_in_base(embodiment, T, g) for g in own]
    tip = T[mount, :3, 3]
    ends = np.concatenate(points) @ axis - anchor @ axis if points else np.zeros(1)
    # Out is where the flange's frame lies of its joint, or else away from where the arm comes from, or else where the link's shape lies.
    for hint in (float((tip - anchor) @ axis), float((anchor - before) @ axis), float(ends.max() + ends.min())):
        if abs(hint) > 5e-3:
            break
    out = axis * (1.0 if hint >= 0 else -1.0)
    R = T[mount, :3, :3]
    if R[:, 2] @ out > _OUTWARD:
        return np.eye(4), ""
    z = R.T @ out
    nearest = np.zeros(3)
    nearest[np.abs(z).argmax()] = np.sign(z[np.abs(z).argmax()])
    z = nearest if z @ nearest > _OUTWARD else z
    x = np.eye(3)[int(np.abs(z).argmin())]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    said = f"z of {embodiment.link_names[mount]!r} does not point out of the arm along its last joint"
    if np.linalg.norm(tip - anchor) < 5e-3 and points:
        pose[:3, 3] = R.T @ (anchor + out * float((np.concatenate(points) @ out - anchor @ out).max()) - tip)
    return pose, said


def _in_base(embodiment: Embodiment, T_links: Array, geom: int) -> Array:
    T = T_links[embodiment.model.geom_bodyid[geom]]
    return geom_vertices(embodiment.model, geom) @ T[:3, :3].T + T[:3, 3]


def reach_m(arm: Embodiment) -> float:
    """The farthest that an arm's flange gets from its second joint, over random poses, m."""
    assert arm.arm is not None
    tree, mount = KinematicTree(arm), arm.body_id(arm.arm.mount_body)
    lower, upper = arm.independent_limits
    u = np.random.default_rng(0).uniform(lower, upper, size=(_POSES, len(lower)))
    T = tree.forward(arm.coupled.expand(u))
    return float(np.linalg.norm(T[:, mount, :3, 3] - T[:, _shoulder(tree, mount), :3, 3], axis=1).max())


def _shoulder(tree: KinematicTree, mount: int) -> int:
    """The link on the arm's second joint, or on its only one."""
    chain = np.flatnonzero(tree.moving(np.array([mount])))
    return int(tree.embodiment.model.jnt_bodyid[chain[min(1, len(chain) - 1)]])


def _home(
    embodiment: Embodiment, tree: KinematicTree, mount: int, T_mount_flange: Array, reach_m: float
) -> tuple[list[float], bool]:
    """Independent joints, in their limits, whose flange points down in front of the arm, elbow up; and whether they do."""
    lower, upper = embodiment.independent_limits
    turns = upper - lower > 2 * np.pi
    low, high = np.where(turns, np.maximum(lower, -np.pi), lower), np.where(turns, np.minimum(upper, np.pi), upper)
    span = high - low
    low, high = low + _MARGIN * span, high - _MARGIN * span
    shoulder = tree.forward(embodiment.home)[_shoulder(tree, mount), :3, 3]
    front = min(_FRONT * reach_m, _MOST_FRONT_M)
    above = min(_ABOVE * reach_m, _MOST_ABOVE_M)
    hanging = shoulder[2] > 0.6 * reach_m  # of a humanoid, say
    height = shoulder[2] - _BELOW_SHOULDER * reach_m if hanging else above
    target = np.array([shoulder[0] + front, shoulder[1] if hanging else 0.0, height])
    middle = np.clip(0.0, low, high)

    def residual(u: Array) -> Array:
        flange = tree.forward(embodiment.coupled.expand(u))[mount] @ T_mount_flange
        off = (flange[:3, 3] - target) / 0.1
        down = (flange[:3, 2] - [0.0, 0.0, -1.0]) / 0.2
        return np.concatenate([off, down, 0.1 * (u - middle)])

    overlaps, rng, best = Overlaps(embodiment), np.random.default_rng(0), None
    for start in rng.uniform(low, high, size=(_STARTS, len(low))):
        found = least_squares(residual, np.clip(start, low + 1e-6, high - 1e-6), bounds=(low, high), max_nfev=60)
        error = residual(found.x)
        inside = overlaps.deepest_m(embodiment.coupled.expand(found.x))
        T = tree.forward(embodiment.coupled.expand(found.x))
        lowest = float(T[tree.arrays.body_joint >= 1, 2, 3].min())
        margin = float((np.minimum(found.x - low, high - found.x) / span).min())
        cost = (
            np.square(error).sum()
            + 1000 * inside
            + (0.0 if hanging else 20 * max(0.0, 0.02 - lowest))
            + 2 * max(0.0, 0.1 - margin)
        )
        if best is None or cost < best[0]:
            best = cost, found.x, float(np.abs(error[:6]).max())
    assert best is not None
    _, u, off = best
    return [rounded(value) for value in u], off < 0.5
