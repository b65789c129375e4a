"""Whether recorded clouds show a robot where its joints say it is, and if not, where they show it.

A cloud in another frame than the base pose goes unnoticed otherwise: nothing is taken out of it, and the target is put in beside
the source. What moves in a cloud is the robot, and what it carries, so those points must lie on its surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud.sample import SurfaceSampler

ON_SURFACE_M = 0.02
"""A point this near to the robot's surface is on it: cameras are noisy, and samples of the surface a centimetre apart."""

_SAMPLES = 16384
_LEAST_POINTS = 150  # that move; fewer say nothing
_PLAIN = 0.6  # share of what moves that is on the robot, where nothing is to be looked for elsewhere: it carries things
_ALL = 0.9
_CONTRADICTS = 0.1
_FOUND = 0.5  # and where it is found far from there
_BETTER = 0.1  # by so much more is on the robot where it is found than where it should be
_TOLERATED_M = 0.025  # calibrations are off by a centimetre or two
_SPACINGS = 3.0  # points farther than so many spacings of a cloud from all of another are not in it
_ABSENT = 0.6  # share of the other frames that a point is absent from to be one that moves, and not one that was hidden
_YAWS = 8
_AROUND_M = (-0.15, 0.0, 0.15)  # what is seen of a robot is one side of it
_ROUNDS, _UPRIGHT_ROUNDS, _LAST_ROUNDS = 40, 12, 5
_REFINED = 6  # of the starts, those that look best after a few rounds
_SEARCHED, _SEARCHED_UPRIGHT = 400, 200  # points that the search looks at
_COARSER = 8  # times fewer samples of the robot will do to tell about where it is
_TRIMMED = 0.7  # share of the nearest pairs that count: what is carried is not the robot's


@dataclass(frozen=True)
class Agreement:
    """How well clouds and joints agree.

    Attributes:
        moving: points that move, in all frames that were looked at.
        share: of them, how many are on the robot where its joints and its base pose say, in [0, 1].
        share_there: how many are on it where it is found.
        offset_m: how far from where it should be it is found, m: the middle of what of it moves.
        T_world_base: (4, 4) pose of the base with which it is found there.
    """

    moving: int
    share: float
    share_there: float
    offset_m: float
    T_world_base: Array

    @property
    def known(self) -> bool:
        """Whether enough moves for anything to be said."""
        return self.moving >= _LEAST_POINTS

    @property
    def elsewhere(self) -> bool:
        """Whether the robot is found in another place than its joints and its base pose say."""
        better = self.share_there >= self.share + _BETTER and self.share_there >= _FOUND
        return self.known and better and self.offset_m > _TOLERATED_M

    @property
    def nowhere(self) -> bool:
        """Whether the robot is neither where it should be nor found elsewhere."""
        return self.known and not self.elsewhere and self.share < _CONTRADICTS


def cloud_agreement(
    embodiment: Embodiment, clouds_world: Sequence[Array], qpos: Array, T_world_base: Array
) -> Agreement:
    """Compare recorded clouds with where the robot should be.

    Args:
        embodiment: the robot.
        clouds_world: T clouds (N, 3 or 6) of one episode, of frames in which the robot is here and there, m.
        qpos: (T, n) its joints then, rad or m.
        T_world_base: (4, 4) pose of its base.
    """
    moving = _moving([cloud[np.isfinite(cloud).all(axis=1), :3] for cloud in clouds_world])
    count = sum(map(len, moving))
    if count < _LEAST_POINTS:
        return Agreement(count, 0.0, 0.0, 0.0, T_world_base)
    tree, sample = KinematicTree(embodiment), SurfaceSampler(visual_link_meshes(embodiment.model), _SAMPLES, 0)
    T_base_links = tree.forward(qpos)
    which = _links_that_move(T_base_links)[sample.link_ids]
    robots = [sample(T_world_base @ links)[which] for links in T_base_links]
    found = _Found(moving, [KDTree(robot) for robot in robots])
    few, share = found.thinned(_SEARCHED), found.share(np.eye(4))
    middle = np.concatenate(robots).mean(axis=0)
    tried = [few.refine(np.eye(4), _ROUNDS)]
    if share < _PLAIN and found.share(tried[0]) < _ALL:
        coarse = _Found(found.thinned(_SEARCHED_UPRIGHT).points, [KDTree(robot[::_COARSER]) for robot in robots])
        upright = [coarse.refine(start, _UPRIGHT_ROUNDS, upright=True) for start in _starts(middle, coarse.middle)]
        tried += [few.refine(start, _ROUNDS) for start in sorted(upright, key=coarse.cost)[:_REFINED]]
    best = found.refine(max(tried, key=found.share), _LAST_ROUNDS)
    offset_m = float(np.linalg.norm(best[:3, :3] @ middle + best[:3, 3] - middle))
    return Agreement(count, share, found.share(best), offset_m, best @ T_world_base)


def _moving(clouds: Sequence[Array]) -> list[Array]:
    """Find the points of each cloud that most of the others lack."""
    trees = [KDTree(cloud) if len(cloud) > 1 else None for cloud in clouds]
    moving = []
    for i, cloud in enumerate(clouds):
        absent, others = np.zeros(len(cloud)), 0
        for j, tree in enumerate(trees):
            if i != j and tree is not None and len(cloud):
                spacing_m = float(np.median(tree.query(tree.data, k=2)[0][:, 1]))
                absent += tree.query(cloud)[0] > max(_SPACINGS * spacing_m, ON_SURFACE_M)
                others += 1
        moving.append(cloud[absent > _ABSENT * max(others, 1)])
    return moving


def _links_that_move(T_links: Array) -> Array:
    """(L,) whether links of poses (T, L, 4, 4) are here and there; all where none is. What stands still is not what moves."""
    far_m = np.ptp(T_links[:, :, :3, 3], axis=0).max(axis=1)
    moves = far_m > ON_SURFACE_M
    return moves if moves.any() else np.ones(len(moves), bool)


def _starts(robot: Array, cloud: Array) -> list[Array]:
    """Motions (4, 4) of the robot that bring its middle (3,) to about the cloud's (3,), turned about the vertical."""
    starts = []
    for yaw, *around in product(np.arange(_YAWS) * 2 * np.pi / _YAWS, *[_AROUND_M] * 3):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
        T[:3, 3] = cloud + around - T[:3, :3] @ robot
        starts.append(T)
    return starts


@dataclass(frozen=True)
class _Found:
    """Points that move, T times (M, 3), and trees of the robot's surface in the same frames."""

    points: Sequence[Array]
    robots: Sequence[KDTree]

    @property
    def middle(self) -> Array:
        """(3,) of all points."""
        return np.concatenate(self.points).mean(axis=0)

    def thinned(self, count: int) -> "_Found":
        """The same with about so many of the points in all."""
        step = -(-sum(map(len, self.points)) // count)
        return _Found([points[::step] for points in self.points], self.robots)

    def share(self, T: Array) -> float:
        """Count the points that are on the robot moved by T (4, 4)."""
        distance_m, _, _ = self._pairs(T)
        return float((distance_m < ON_SURFACE_M).mean())

    def cost(self, T: Array) -> float:
        """Mean distance of the nearest points to the robot moved by T, m: what `refine` lowers."""
        distance_m, _, _ = self._pairs(T)
        return float(np.sort(distance_m)[: int(_TRIMMED * len(distance_m)) + 1].mean())

    def refine(self, T: Array, rounds: int, upright: bool = False) -> Array:
        """The motion near T that brings the robot to the points: iterated closest points, the farthest left out.

        Args:
            T: (4, 4) to start from.
            rounds: how many.
            upright: turn about the vertical alone.
        """
        for _ in range(rounds):
            distance_m, robot, points = self._pairs(T)
            near = distance_m <= np.quantile(distance_m, _TRIMMED)
            robot, points = robot[near], points[near]
            centred, moved = robot - robot.mean(axis=0), points - points.mean(axis=0)
            if upright:
                yaw = np.arctan2(
                    np.sum(centred[:, 0] * moved[:, 1] - centred[:, 1] * moved[:, 0]),
                    np.sum(centred[:, :2] * moved[:, :2]),
                )
                R = Rotation.from_euler("z", yaw)
            else:
                R = Rotation.align_vectors(moved, centred)[0]
            T = np.eye(4)
            T[:3, :3] = R.as_matrix()
            T[:3, 3] = points.mean(axis=0) - T[:3, :3] @ robot.mean(axis=0)
        return T

    def _pairs(self, T: Array) -> tuple[Array, Array, Array]:
        """(M,) distances, and the pairs (M, 3): points of the robot, unmoved, and the points that are nearest to them when moved."""
        distance_m, robot = [], []
        for points, tree in zip(self.points, self.robots, strict=True):
            distance, nearest = tree.query((points - T[:3, 3]) @ T[:3, :3])
            distance_m.append(distance)
            robot.append(tree.data[nearest])
        return np.concatenate(distance_m), np.concatenate(robot), np.concatenate(self.points)
