"""Links as convex shapes: which have to stay clear of what."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from cei_gym.alignment.kernels.collision import CollisionConstraint, Obstacles
from cei_gym.alignment.options import ClearanceOptions
from cei_gym.alignment.problem import AlignmentProblem, Surroundings
from cei_gym.arrays import Array
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.meshes import collision_geoms, geom_vertices, outermost, spread_directions
from cei_gym.kinematics import KinematicTree
from cei_gym.kinematics.joints import JointTree, reduce_to_joints

_SIDES = 64  # directions that bound a link against points


@dataclass(frozen=True)
class LinkShapes:
    """The moving links (and all of the hand) that have collision geoms.

    Attributes:
        body: (K,) link.
        hand: (K,) whether it belongs to the end-effector.
        vertices_link: for each, (V, 3) outermost vertices in the link's frame, m.
    """

    body: Array
    hand: Array
    vertices_link: list[Array]

    def lowest(self, T_links: Array) -> float:
        """Height of the lowest vertex over (T, L, 4, 4) poses, in their frame, m."""
        heights = [
            (T_links[:, body, 2, :3] @ vertices.T).min(axis=1) + T_links[:, body, 2, 3]
            for body, vertices in zip(self.body, self.vertices_link, strict=True)
        ]
        return float(np.min(heights))


def link_shapes(embodiment: Embodiment) -> LinkShapes:
    """Outermost vertices of an embodiment's links; found once for each embodiment."""
    if (shapes := _known.get(embodiment)) is None:
        shapes = _known[embodiment] = _link_shapes(embodiment)
    return shapes


_known: WeakKeyDictionary[Embodiment, LinkShapes] = WeakKeyDictionary()


def _link_shapes(embodiment: Embodiment) -> LinkShapes:
    hand = embodiment.of_end_effector
    moving = KinematicTree(embodiment).arrays.body_joint >= 0
    bodies, vertices = [], []
    for body in np.flatnonzero(moving | hand):
        geoms = collision_geoms(embodiment.model, int(body))
        if len(geoms):
            bodies.append(int(body))
            vertices.append(outermost(np.concatenate([geom_vertices(embodiment.model, geom) for geom in geoms])))
    return LinkShapes(np.array(bodies, int), hand[bodies], vertices)


def idle_bodies(problem: AlignmentProblem) -> Array:
    """(L,) links of fingers that carry no pad: moved by a joint of the hand that moves no pad."""
    carries = problem.tree.moving(problem.representation.body)
    joint = problem.tree.arrays.body_joint
    return (joint >= problem.embodiment.n_arm) & ~carries[joint]


def collision_constraint(problem: AlignmentProblem, options: ClearanceOptions) -> CollisionConstraint:
    """The links for compiled code; the support's height is still to be set."""
    shapes = link_shapes(problem.embodiment)
    joints, attachment = reduce_to_joints(problem.tree.arrays)
    idle = idle_bodies(problem)[shapes.body]
    moving = attachment.joint[shapes.body] >= 0
    # What only turns about a vertical axis at the base stays at its height: a shoulder on the table is where it must be.
    turns_in_place = joints.hinge & (joints.parent < 0) & (np.abs(_axis_base(joints)[:, 2]) > 0.999)
    moving &= ~turns_in_place[attachment.joint[shapes.body]]
    shapes = LinkShapes(
        shapes.body[moving], shapes.hand[moving], [v for v, m in zip(shapes.vertices_link, moving, strict=True) if m]
    )
    idle = idle[moving]
    placed = [
        vertices @ attachment.rot[body].T + attachment.pos[body]
        for body, vertices in zip(shapes.body, shapes.vertices_link, strict=True)
    ]
    sides = spread_directions(_SIDES)
    centre = np.array([(v.min(axis=0) + v.max(axis=0)) / 2 for v in placed]).reshape(-1, 3)
    radius = np.array([np.linalg.norm(v - c, axis=1).max() for v, c in zip(placed, centre, strict=True)])
    margin = np.where(shapes.hand, options.hand_margin_m, options.arm_margin_m)
    return CollisionConstraint(
        weight=float(options.weight),
        height_m=-np.inf,
        body=shapes.body,
        joint=attachment.joint[shapes.body],
        margin_m=np.where(idle, options.idle_margin_m, margin).astype(float),
        start=np.concatenate([[0], np.cumsum([len(v) for v in placed])]).astype(np.int64),
        vertices=np.concatenate([np.zeros((0, 3)), *placed]),
        directions=sides,
        reach=np.array([(v @ sides.T).max(axis=0) for v in placed]).reshape(-1, len(sides)),
        centre=centre,
        radius=radius,
        idle=idle,
    )


def pack_obstacles(surroundings: Surroundings | None, frames: int) -> Obstacles:
    """The points of all frames for compiled code."""
    points = () if surroundings is None else surroundings.obstacles_base
    start = np.zeros(frames + 1, np.int64)
    if len(points):
        start[1:] = np.cumsum([len(p) for p in points])
    return Obstacles(np.concatenate([np.zeros((0, 3)), *points]), start)


def _axis_base(joints: JointTree) -> Array:
    """(n, 3) axes in the frame of each joint's parent: the base frame for those that have none."""
    return np.einsum("nij,nj->ni", joints.rot, joints.axis)


def no_collision_constraint() -> CollisionConstraint:
    """No links and no weight: what compiled code gets while nothing is too near."""
    ints, floats, points = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3))
    no_vertices = np.zeros(1, np.int64), points
    return CollisionConstraint(
        0.0, -np.inf, ints, ints, floats, *no_vertices, points, points, points, floats, np.zeros(0, bool)
    )
