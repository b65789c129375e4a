"""How an end-effector sits on a flange, as far as its shape tells."""

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.meshes import collision_geoms, geom_vertices
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding.closing import Closing
from cei_gym.onboarding.digits import rounded
from cei_gym.onboarding.fingers import Finger, pointing

_ALONG = 1e-6
_SNAP_RAD = np.radians(25)  # within which a mount follows the axes of the first link


def guess_mount(
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
    ahead = R_base_root.T @ pointing(
        embodiment, tree, [f for f in fingers if f.joints and (len(fingers) < 4 or f not in closing.sides[0])]
    )
    z, along_an_axis = snapped(ahead)
    beside = across - (across @ z) * z
    if np.linalg.norm(beside) < _ALONG:  # fingers close along the way they point
        beside = np.eye(3)[int(np.abs(z).argmin())]
    y, _ = snapped(beside)
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
    return [rounded(x) for x in shift], [round(float(x), 6) + 0.0 for x in quat], along_an_axis


def _fixed_to_root(tree: KinematicTree, root: int) -> list[int]:
    own = tree.arrays.body_joint[root]
    return [body for body in range(root, len(tree.arrays.parent)) if tree.arrays.body_joint[body] == own]


def snapped(direction: Array) -> tuple[Array, bool]:
    """The axis that a direction is about along, or the direction itself; and whether it is an axis."""
    unit = direction / np.linalg.norm(direction)
    axis = np.zeros(3)
    axis[np.abs(unit).argmax()] = np.sign(unit[np.abs(unit).argmax()])
    return (axis, True) if unit @ axis > np.cos(_SNAP_RAD) else (unit, False)
