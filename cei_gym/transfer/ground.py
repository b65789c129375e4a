"""Where a base cannot stand: on what the hand works on, on objects, or in the workspace."""

from collections.abc import Sequence

import numpy as np

from cei_gym.arrays import Array
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.meshes import collision_geoms, geom_vertices
from cei_gym.kinematics import KinematicTree
from cei_gym.transfer.scenes import Scenes

_AROUND_M = 0.05  # between a base, and pads or objects beside it
_LEAST_FOOTPRINT_M = 0.05
_ABOVE_SUPPORT_M = 0.01
_CELL_M = 0.01


class Ground:
    """The ground around objects, seen from above.

    Args:
        embodiment: what shall stand there.
        pads_world: (..., 3) where the source's pads were, m.
        shown: demonstrations whose clouds show objects as they begin, if they have any.
        scenes: takes the source out of these.
        scene: with the workspace.
    """

    def __init__(
        self,
        embodiment: Embodiment,
        pads_world: Array,
        shown: Sequence[Demonstration],
        scenes: Scenes,
        scene: Scene,
    ) -> None:
        self.footprint_m = footprint_m(embodiment)
        taken = np.concatenate([pads_world[..., :2].reshape(-1, 2), _objects(scenes, shown)])
        self._taken_world = np.unique(np.round(taken / _CELL_M), axis=0) * _CELL_M
        self._box_world = _box_of(scene)

    def among_m(self, position_m: Array) -> float:
        """How far a base at x, y (world, m) is in what the hand works on, m; 0 where it is clear."""
        apart_m = float(np.linalg.norm(self._taken_world - position_m[:2], axis=1).min())
        among_m = max(0.0, self.footprint_m + _AROUND_M - apart_m)
        if self._box_world is None:
            return among_m
        outside = np.maximum(self._box_world[0] - position_m[:2], position_m[:2] - self._box_world[1])
        apart_m = float(np.linalg.norm(np.maximum(outside, 0.0))) + min(0.0, float(outside.max()))
        return max(among_m, self.footprint_m - apart_m)


def footprint_m(embodiment: Embodiment) -> float:
    """Radius of what an arm stands on: how far the links that no joint moves extend from its base's axis, m."""
    T_links = KinematicTree(embodiment).forward(embodiment.home)
    radius_m = _LEAST_FOOTPRINT_M
    for body in np.flatnonzero((embodiment.model.body_weldid == 0) & ~embodiment.of_end_effector):
        for geom in collision_geoms(embodiment.model, int(body)):
            vertices = geom_vertices(embodiment.model, geom) @ T_links[body, :3, :3].T + T_links[body, :3, 3]
            radius_m = max(radius_m, float(np.linalg.norm(vertices[:, :2], axis=1).max()))
    return radius_m


def _objects(scenes: Scenes, shown: Sequence[Demonstration]) -> Array:
    """(M, 2) where objects stand as demonstrations begin, as far as clouds show any, x and y, world, m."""
    found: list[Array] = [np.zeros((0, 2))]
    for demonstration in shown:
        first = demonstration.at(np.array([0]))
        for points in scenes.without_source(first):
            above = points[points[:, 2] > first.scene.support_z_m + _ABOVE_SUPPORT_M]
            found.append(above[:, :2].astype(float))
    return np.concatenate(found)


def _box_of(scene: Scene) -> Array | None:
    """(2, 2) the workspace from above, world, m; None where the source itself stands in it: it then says how far clouds go, no more."""
    low, high = box = scene.workspace_world[:, :2]
    source = scene.T_world_base[:2, 3]
    return None if bool((low <= source).all() and (source <= high).all()) else box
