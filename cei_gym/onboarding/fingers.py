"""The fingers of an end-effector: what ends each, which joints move it, and its surface."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.meshes import collision_geoms, link_mesh
from cei_gym.embodiment.names import public_name
from cei_gym.functional.palmar import outer_mask
from cei_gym.kinematics import KinematicTree

_POINTS = 80
_LEAST_M = 0.008  # of a fingertip: what is smaller is a mark, not a surface
_THUMB = ("thumb", "thj", "thdistal", "daumen")


@dataclass(frozen=True, eq=False)
class Finger:
    """What ends a finger, or a jaw that stands still.

    Attributes:
        body: index of the link that has its surface.
        link: its name in the description.
        joints: indices of the independent joints that move it, from the palm to the tip; empty for a fixed jaw.
        chain: indices of all joints that move it, likewise.
        first_joint: index of the first of them that moves no other finger; -1 for a fixed jaw.
        points_link, normals_link: (P, 3) of its outer surface in the link's frame, m and unit.
        geoms: names of its shapes, where none of them can touch as its description has it; else empty.
        axis_link: (3,) unit, from its last joint along it, in the link's frame.
        named_thumb: whether it is called one.
    """

    body: int
    link: str
    joints: tuple[int, ...]
    chain: tuple[int, ...]
    first_joint: int
    points_link: Array
    normals_link: Array
    geoms: tuple[str, ...]
    axis_link: Array
    named_thumb: bool


def find_fingers(embodiment: Embodiment, tree: KinematicTree) -> list[list[Finger]]:
    """For each end of an end-effector's chains the links that may be its surface, the likeliest first; where only one moves, what stands
    still beside it."""
    found = [fingers for group in _ends(embodiment, tree) if (fingers := _of_group(embodiment, tree, group))]
    if len(found) == 1:
        found += [[jaw] for jaw in _fixed_jaws(embodiment, tree)]
    return [[replace(finger, first_joint=_first_own(finger, found)) for finger in fingers] for fingers in found]


def _first_own(finger: Finger, groups: list[list[Finger]]) -> int:
    shared = {joint for group in groups if finger not in group for joint in group[0].chain}
    return next((joint for joint in finger.chain if joint not in shared), finger.chain[-1] if finger.chain else -1)


def _rigid_with(tree: KinematicTree) -> Array:
    """(L,) of each link the first that it is fixed to: itself where a joint moves it."""
    arrays = tree.arrays
    first = np.arange(len(arrays.parent))
    for body in range(1, len(first)):
        if arrays.joint_start[body] == arrays.joint_start[body + 1]:
            first[body] = first[arrays.parent[body]]
    return first


def _ends(embodiment: Embodiment, tree: KinematicTree) -> list[list[int]]:
    """Links of each rigid group that moves and carries no other."""
    first, parent = _rigid_with(tree), tree.arrays.parent
    carries = {int(first[parent[body]]) for body in range(1, len(parent)) if first[body] == body}
    moving = [int(body) for body in np.unique(first) if tree.arrays.body_joint[body] >= 0]
    return [[int(b) for b in np.flatnonzero(first == body)] for body in moving if body not in carries]


def _of_group(embodiment: Embodiment, tree: KinematicTree, group: list[int]) -> list[Finger]:
    """The links of a rigid group that are large enough to touch with, the one that reaches farthest from its joint first."""
    T_links = tree.forward(embodiment.home)
    anchor = T_links[group[0], :3, 3]
    found = []
    for body in group:
        mesh = link_mesh(embodiment.model, _geoms(embodiment, body))
        if mesh is not None and np.max(mesh.extents) >= _LEAST_M:
            reach_m = np.linalg.norm(trimesh.transform_points(mesh.vertices, T_links[body]) - anchor, axis=1).max()
            found.append((float(reach_m), body, mesh))
    return [_of(embodiment, tree, body, mesh) for _, body, mesh in sorted(found, key=lambda each: -each[0])]


def _geoms(embodiment: Embodiment, body: int) -> Array:
    """What of a link can touch, or, where nothing of it can, what is seen."""
    touching = collision_geoms(embodiment.model, body)
    return touching if len(touching) else np.flatnonzero(embodiment.model.geom_bodyid == body)


def _fixed_jaws(embodiment: Embodiment, tree: KinematicTree) -> list[Finger]:
    still = [b for b in range(1, len(tree.arrays.parent)) if tree.arrays.body_joint[b] < 0]
    meshes = [(body, link_mesh(embodiment.model, _geoms(embodiment, body))) for body in still]
    return [_of(embodiment, tree, body, mesh) for body, mesh in meshes if mesh is not None]


def _of(embodiment: Embodiment, tree: KinematicTree, body: int, mesh: trimesh.Trimesh) -> Finger:
    count = _POINTS if tree.arrays.body_joint[body] >= 0 else 10 * _POINTS  # of a palm only a part is jaw
    points, faces = trimesh.sample.sample_surface(mesh, 3 * count, seed=0)[:2]
    points, normals = np.asarray(points), np.asarray(mesh.face_normals[faces])
    outer = outer_mask(mesh, points, normals)
    points, normals = points[outer][:count], normals[outer][:count]
    names_of_geoms = [public_name(embodiment.model.geom(g).name) for g in _geoms(embodiment, body)]
    chain = np.flatnonzero(tree.moving(np.array([body]))).tolist()
    joints = [int(embodiment.coupled.leader[joint]) for joint in chain]
    axis = points.mean(axis=0)
    if (joint := tree.arrays.body_joint[body]) >= 0:
        holder = embodiment.model.jnt_bodyid[joint]
        T = tree.forward(embodiment.home)
        axis = axis - T[body, :3, :3].T @ (
            T[holder, :3, :3] @ tree.arrays.anchor[joint] + T[holder, :3, 3] - T[body, :3, 3]
        )
    axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
    names = [embodiment.link_names[body]]
    names += [
        embodiment.joint_names[embodiment.coupled.independent[u]] for u in joints[-1:]
    ]  # the last, which is its own
    words = [word for name in names for word in name.lower().replace("-", "_").replace(".", "_").split("_")]
    thumb = any(word.startswith(_THUMB) for word in words)
    return Finger(
        body,
        embodiment.link_names[body],
        tuple(dict.fromkeys(joints)),
        tuple(chain),
        -1,
        points,
        normals,
        () if len(collision_geoms(embodiment.model, body)) else tuple(names_of_geoms),
        axis,
        thumb,
    )


def anchor(embodiment: Embodiment, tree: KinematicTree, finger: Finger) -> Array:
    """(3,) where a finger's first own joint is, m."""
    body = embodiment.model.jnt_bodyid[finger.first_joint]
    return tree.forward(embodiment.home)[body, :3, 3]


def pointing(embodiment: Embodiment, tree: KinematicTree, fingers: list[Finger]) -> Array:
    """(3,) where stretched fingers point, in the base frame."""
    T_links = tree.forward(embodiment.coupled.expand(_neutral(embodiment)))
    ways = []
    for finger in fingers:
        T = T_links[finger.body]
        way = finger.points_link @ T[:3, :3].T + T[:3, 3] - anchor(embodiment, tree, finger)
        farthest = way[np.linalg.norm(way, axis=1).argsort()[-len(way) // 5 :]].mean(axis=0)
        ways.append(farthest / np.linalg.norm(farthest))
    return np.sum(ways, axis=0)


def _neutral(embodiment: Embodiment) -> Array:
    """(m,) 0, or the nearest that limits allow."""
    return np.clip(np.zeros(len(embodiment.coupled.independent)), *embodiment.independent_limits)
