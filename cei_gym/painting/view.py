"""A robot as one camera sees it, drawn finer than the camera's pixels so that edges are smooth."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import Embodiment
from cei_gym.embodiment.colours import geom_colours
from cei_gym.embodiment.meshes import visual_geoms
from cei_gym.kinematics import KinematicTree
from cei_gym.rendering import DepthCamera, image_points, resized


@dataclass(frozen=True)
class Drawn:
    """A robot in a part of a picture.

    Attributes:
        camera: of that part, with `finer` pixels to one of the picture's in each direction.
        row, column: of the picture's pixel in its upper left corner.
        finer: see above.
        depth_m: (h, w) along the optical axis, 0 where the robot is not.
        geom_id: (h, w), -1 where it is not.
    """

    camera: Camera
    row: int
    column: int
    finer: int
    depth_m: Array
    geom_id: Array

    @property
    def share(self) -> Array:
        """(h, w) of each of the picture's pixels there, how much is the robot."""
        height, width = self.depth_m.shape
        blocks = (self.geom_id >= 0).reshape(height // self.finer, self.finer, width // self.finer, self.finer)
        return blocks.mean(axis=(1, 3))

    @property
    def part(self) -> tuple[slice, slice]:
        """Where in the picture it is."""
        height, width = self.depth_m.shape
        rows = slice(self.row, self.row + height // self.finer)
        return rows, slice(self.column, self.column + width // self.finer)


class RobotView:
    """Draws an embodiment at joint positions, and others beside it.

    Args:
        embodiment: whose visual geoms are drawn.
        T_world_base: (4, 4) pose of its base.
        camera: what sees it.
        beside: others on the same base, such as a humanoid's other arm; their joints and geoms come after its own, in turn.

    Attributes:
        colours: (ngeom, 3) of all geoms in [0, 1].
        links: (ngeom,) whose they are, as in `poses`.
    """

    def __init__(
        self, embodiment: Embodiment, T_world_base: Array, camera: Camera, beside: Sequence[Embodiment] = ()
    ) -> None:
        self.camera = camera
        robots = (embodiment, *beside)
        self._T_world_base, self._trees = T_world_base, [KinematicTree(robot) for robot in robots]
        self._ends = np.cumsum([len(robot.joint_names) for robot in robots])[:-1]
        self._eyes = [DepthCamera(robot.model, (), geoms=visual_geoms(robot.model)) for robot in robots]
        self._corners = [_corners(robot.model) for robot in robots]
        colours = [geom_colours(robot.model)[:, :3] for robot in robots]
        self._first_geoms = np.cumsum([0, *map(len, colours)])
        self.colours = np.ascontiguousarray(np.concatenate(colours), float)
        first_links = np.cumsum([0, *(robot.model.nbody for robot in robots)])
        self.links = np.concatenate(
            [robot.model.geom_bodyid + first for robot, first in zip(robots, first_links[:-1], strict=True)]
        )

    def poses(self, qpos: Array) -> Array:
        """(links, 4, 4) poses in the world of all robots' links at (n,) joint positions."""
        return np.concatenate(self._placed(qpos))

    def _placed(self, qpos: Array) -> list[Array]:
        joints = zip(self._trees, np.split(qpos, self._ends), strict=True)
        return [self._T_world_base @ tree.forward(q) for tree, q in joints]

    def draw(self, qpos: Array, finer: int = 1, camera: Camera | None = None) -> Drawn:
        """The part of the picture that shows the robots.

        Args:
            qpos: (n,) joint positions, rad or m, of all of them.
            finer: pixels to draw for one of the picture's, in each direction.
            camera: another that sees it.
        """
        camera = camera or self.camera
        T_world_links = self._placed(qpos)
        top, left, bottom, right = self._box(T_world_links, camera)
        K = camera.K.copy()
        K[0, 2] -= left
        K[1, 2] -= top
        part = replace(camera, width=(right - left) * finer, height=(bottom - top) * finer, K=resized(K, finer))
        depth_m, geom_id = np.zeros((part.height, part.width), np.float32), np.full((part.height, part.width), -1)
        for eye, T, first in zip(self._eyes, T_world_links, self._first_geoms[:-1], strict=True):
            its_depth_m, its_geom_id = eye.render_at(T, (part,))[part.name]
            nearer = (its_geom_id >= 0) & ((geom_id < 0) | (its_depth_m < depth_m))
            depth_m = np.where(nearer, its_depth_m, depth_m)
            geom_id = np.where(nearer, its_geom_id + first, geom_id)
        return Drawn(part, top, left, finer, depth_m, geom_id)

    def silhouette(self, qpos: Array) -> Array:
        """(H, W) bool, where the robots are at (n,) joint positions, whatever is before it."""
        drawn = self.draw(qpos)
        mask = np.zeros((self.camera.height, self.camera.width), bool)
        mask[drawn.part] = drawn.geom_id >= 0
        return mask

    def _box(self, T_world_links: Sequence[Array], camera: Camera) -> tuple[int, int, int, int]:
        """First row and column and those past the last, of the pixels that may show the robot; all where part of it is behind the camera."""
        corners = zip(self._corners, T_world_links, strict=True)
        placed = np.concatenate(
            [np.einsum("pij,pj->pi", T[body, :3, :3], points) + T[body, :3, 3] for (body, points), T in corners]
        )
        whole = 0, 0, camera.height, camera.width
        uv, depth_m = image_points(placed, camera)
        if (depth_m < 0.05).any():
            return whole
        u, v = uv.T
        top, bottom = np.clip([np.floor(v.min()) - 1, np.ceil(v.max()) + 2], 0, whole[2]).astype(int)
        left, right = np.clip([np.floor(u.min()) - 1, np.ceil(u.max()) + 2], 0, whole[3]).astype(int)
        return (int(top), int(left), int(bottom), int(right)) if top < bottom and left < right else (0, 0, 1, 1)


def delayed(qpos: Array, by_frames: float) -> Array:
    """(T, n) joints that pictures show which trail them: at frame t those of t - by_frames, between frames in proportion, at the ends as there."""
    at = np.clip(np.arange(len(qpos)) - by_frames, 0, len(qpos) - 1)
    first = np.minimum(at.astype(int), max(0, len(qpos) - 2))
    share = (at - first)[:, None]
    return (1 - share) * qpos[first] + share * qpos[np.minimum(first + 1, len(qpos) - 1)]


def _corners(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Body (P,) and position (P, 3) in its frame, m, of the corners of boxes around what a camera sees."""
    geoms = np.flatnonzero(visual_geoms(model))
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    R = Rotation.from_quat(model.geom_quat[geoms], scalar_first=True).as_matrix()
    points = np.einsum("gij,gkj->gki", R, middle[:, None] + signs * half[:, None]) + model.geom_pos[geoms][:, None]
    return np.repeat(model.geom_bodyid[geoms], len(signs)), points.reshape(-1, 3)
