"""A robot as one camera sees it, drawn finer than the camera's pixels so that edges are smooth."""

import itertools
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
    """Draws an embodiment at joint positions.

    Args:
        embodiment: whose visual geoms are drawn.
        T_world_base: (4, 4) pose of its base.
        camera: what sees it.

    Attributes:
        colours: (ngeom, 3) of its geoms in [0, 1].
    """

    def __init__(self, embodiment: Embodiment, T_world_base: Array, camera: Camera) -> None:
        self.camera = camera
        self._T_world_base, self._tree = T_world_base, KinematicTree(embodiment)
        self._eye = DepthCamera(embodiment.model, (), geoms=visual_geoms(embodiment.model))
        self._corners = _corners(embodiment.model)
        self.colours = np.ascontiguousarray(geom_colours(embodiment.model)[:, :3], float)

    def draw(self, qpos: Array, finer: int = 1, camera: Camera | None = None) -> Drawn:
        """The part of the picture that shows the robot.

        Args:
            qpos: (n,) joint positions, rad or m.
            finer: pixels to draw for one of the picture's, in each direction.
            camera: another that sees it.
        """
        camera = camera or self.camera
        T_world_links = self._T_world_base @ self._tree.forward(qpos)
        top, left, bottom, right = self._box(T_world_links, camera)
        K = camera.K.copy()
        K[0, 2] -= left
        K[1, 2] -= top
        part = replace(camera, width=(right - left) * finer, height=(bottom - top) * finer, K=resized(K, finer))
        depth_m, geom_id = self._eye.render_at(T_world_links, (part,))[part.name]
        return Drawn(part, top, left, finer, depth_m, geom_id)

    def silhouette(self, qpos: Array) -> Array:
        """(H, W) bool, where the robot is at (n,) joint positions, whatever is before it."""
        drawn = self.draw(qpos)
        mask = np.zeros((self.camera.height, self.camera.width), bool)
        mask[drawn.part] = drawn.geom_id >= 0
        return mask

    def _box(self, T_world_links: Array, camera: Camera) -> tuple[int, int, int, int]:
        """First row and column and those past the last, of the pixels that may show the robot; all where part of it is behind the camera."""
        body, points = self._corners
        placed = np.einsum("pij,pj->pi", T_world_links[body, :3, :3], points) + T_world_links[body, :3, 3]
        whole = 0, 0, camera.height, camera.width
        uv, depth_m = image_points(placed, camera)
        if (depth_m < 0.05).any():
            return whole
        u, v = uv.T
        top, bottom = np.clip([np.floor(v.min()) - 1, np.ceil(v.max()) + 2], 0, whole[2]).astype(int)
        left, right = np.clip([np.floor(u.min()) - 1, np.ceil(u.max()) + 2], 0, whole[3]).astype(int)
        return (int(top), int(left), int(bottom), int(right)) if top < bottom and left < right else (0, 0, 1, 1)


def _corners(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Body (P,) and position (P, 3) in its frame, m, of the corners of boxes around what a camera sees."""
    geoms = np.flatnonzero(visual_geoms(model))
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    R = Rotation.from_quat(model.geom_quat[geoms], scalar_first=True).as_matrix()
    points = np.einsum("gij,gkj->gki", R, middle[:, None] + signs * half[:, None]) + model.geom_pos[geoms][:, None]
    return np.repeat(model.geom_bodyid[geoms], len(signs)), points.reshape(-1, 3)
