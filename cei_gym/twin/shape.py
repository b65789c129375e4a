"""What is held as shapes that physics can have: spheres, cylinders, boxes, and hulls."""

from dataclasses import dataclass, field

import mujoco
import numpy as np

from cei_gym.arrays import Array


@dataclass(frozen=True)
class Piece:
    """One convex shape.

    Attributes:
        kind: "sphere", "cylinder", "box" or "hull".
        size_m: MuJoCo's: radius; radius and half height; three half edges; nothing of a hull.
        centre_world: (3,) m, at the start.
        rotation: (3, 3) of its own axes in the world.
        vertices_world: (V, 3) of a hull, m.
    """

    kind: str
    size_m: tuple[float, ...] = ()
    centre_world: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    vertices_world: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def lowest_m(self) -> float:
        """Height of its lowest point, world."""
        down = self.rotation[2]  # its own axes' vertical components
        if self.kind == "hull":
            return float(self.vertices_world[:, 2].min())
        if self.kind == "sphere":
            reach = self.size_m[0]
        elif self.kind == "box":
            reach = float(np.abs(down) @ self.size_m)
        else:
            reach = abs(down[2]) * self.size_m[1] + np.hypot(down[0], down[1]) * self.size_m[0]
        return float(self.centre_world[2] - reach)


@dataclass(frozen=True)
class Shape:
    """What is held, as pieces that are one body.

    Attributes:
        name: how it was found.
        pieces: at least one.
    """

    name: str
    pieces: tuple[Piece, ...]

    @property
    def primitive(self) -> bool:
        """Whether it is a sphere, a cylinder or a box: of these pixels show enough to know the whole surface."""
        return all(piece.kind != "hull" for piece in self.pieces)

    @property
    def lowest_m(self) -> float:
        """Height of its lowest point, world."""
        return min(piece.lowest_m for piece in self.pieces)


KINDS = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "hull": mujoco.mjtGeom.mjGEOM_MESH,
}
"""A piece's kind to MuJoCo's."""
