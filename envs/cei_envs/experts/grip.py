"""How a hand takes hold of things: a frame between the pads that oppose each other, and the joint positions from open to closed."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from cei_gym.alignment.links import link_shapes
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree

_POINTS = 64
_SHARES = np.linspace(0.0, 1.0, 41)


@dataclass(frozen=True)
class Grip:
    """What an expert moves, and how it closes.

    Attributes:
        frame: a frame of the embodiment's model, which moves with the hand.
        kind: "site" or "body".
        T_frame_grip: (4, 4) the grip in it: z out of the palm, y from one side of what is held to the other.
        opened, closed: (h,) positions of the end-effector's joints, rad or m.
        reach_m: how far pads go beyond it, along its z.
        tip_m: how far links of the hand go beyond it along its z, on the way from open to what it holds.
        widths_m: (41,) room between the pads at shares 0, 1/40, ... 1 of the way from open to closed.
    """

    frame: str
    kind: str
    T_frame_grip: Array
    opened: Array
    closed: Array
    reach_m: float
    tip_m: float
    widths_m: Array

    def joints(self, share: Array) -> Array:
        """(..., h) positions of the end-effector's joints at shares (...) of the way to closed."""
        return self.opened + np.asarray(share)[..., None] * (self.closed - self.opened)

    def share_of(self, width_m: float) -> float:
        """The share at which what is this wide just fits between the pads; 0 where it never does."""
        return float(_SHARES[_fitting(self.widths_m, width_m)])


def grip_between_pads(
    embodiment: Embodiment,
    width_m: float,
    opened: Mapping[str, float] | None = None,
    closed: Mapping[str, float] | None = None,
    facing_root: Array | None = None,
) -> Grip:
    """The grip of a hand on something of a width: between its first pad and the others.

    Args:
        embodiment: the robot.
        width_m: of what it takes hold of, across.
        opened, closed: positions of the end-effector's joints by name where they differ from its home and its closed, rad or m.
        facing_root: (3,) where the palm faces in the frame of the end-effector's first link; default: from there to between the pads.
    """
    assert embodiment.end_effector is not None
    hand = slice(embodiment.n_arm, None)
    names = embodiment.joint_names[hand]
    start, end = (
        _named(embodiment, names, values, given)
        for values, given in ((embodiment.home[hand], opened), (embodiment.closed[hand], closed))
    )
    representation, tree = sample_representation(embodiment, _POINTS), KinematicTree(embodiment)
    qpos = np.tile(embodiment.home, (len(_SHARES), 1))
    qpos[:, hand] = start + _SHARES[:, None] * (end - start)
    T_links = tree.forward(qpos)
    points, _ = representation.place(T_links)
    to_root = np.linalg.inv(T_links[:, embodiment.end_effector_root])
    points = np.einsum("tij,tnj->tni", to_root[:, :3, :3], points) + to_root[:, None, :3, 3]
    pads = [embodiment.body_id(pad.body) for pad in embodiment.end_effector.pads]
    middles = np.stack([points[:, representation.body == pad].mean(axis=1) for pad in pads])
    one, others = middles[0], middles[1:].mean(axis=0)
    widths = np.linalg.norm(others - one, axis=-1)
    at = _fitting(widths, width_m)
    middle, across = (one[at] + others[at]) / 2, others[at] - one[at]
    T_root_grip = _frame(middle, across, middle if facing_root is None else facing_root)
    reach_m = float(((points[at] - T_root_grip[:3, 3]) @ T_root_grip[:3, 2]).max())
    tip_m = _lowest(embodiment, np.linalg.inv(T_root_grip) @ to_root[: at + 1], T_links[: at + 1])
    root = embodiment.model.body(embodiment.end_effector_root).name
    return Grip(root, "body", T_root_grip, start, end, reach_m, tip_m, widths)


def _lowest(embodiment: Embodiment, to_grip: Array, T_links: Array) -> float:
    """How far the hand's links go along the grip's z, m, in any of the (T, L, 4, 4) poses, with (T, 4, 4) to the grip's frame."""
    shapes = link_shapes(embodiment)
    T = to_grip[:, None] @ T_links
    return max(
        float((vertices @ T[:, body, 2, :3].T + T[:, body, 2, 3]).max())
        for body, vertices, hand in zip(shapes.body, shapes.vertices_link, shapes.hand, strict=True)
        if hand
    )


def _fitting(widths: Array, width_m: float) -> int:
    """Index of the last share at which there is so much room; 0 where there never is."""
    fits = np.flatnonzero(widths >= width_m)
    return int(fits[-1]) if len(fits) else 0


def _frame(middle: Array, across: Array, facing: Array) -> Array:
    y = across / np.linalg.norm(across)
    z = facing - y * (y @ facing)
    z /= np.linalg.norm(z)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([np.cross(y, z), y, z], axis=1), middle
    return T


def _named(embodiment: Embodiment, names: tuple[str, ...], values: Array, given: Mapping[str, float] | None) -> Array:
    """(h,) the values with those that are given in their place.

    Raises:
        CEIError: there is no such joint.
    """
    found = values.copy()
    for name, value in (given or {}).items():
        if name not in names:
            raise CEIError(f"{embodiment.name} has no joint {name} to take hold with.")
        found[names.index(name)] = value
    return found


def site_grip(embodiment: Embodiment) -> Grip:
    """The grip at the site that robosuite's grippers have, from home to closed.

    Raises:
        CEIError: the end-effector's description has no such site.
    """
    site, hand = "ee/grip_site", slice(embodiment.n_arm, None)
    if mujoco.mj_name2id(embodiment.model, mujoco.mjtObj.mjOBJ_SITE, site) < 0:
        raise CEIError(
            f"{embodiment.name}: the end-effector's description has no site named 'grip_site', which is what moves."
        )
    return Grip(
        site, "site", np.eye(4), embodiment.home[hand], embodiment.closed[hand], 0.0, 0.0, np.zeros(len(_SHARES))
    )
