"""The pads of an end-effector as what closes on objects: which oppose each other, and their shapes."""

from dataclasses import dataclass

import numpy as np

from cei_gym.arrays import Array
from cei_gym.embodiment.meshes import outermost
from cei_gym.functional.palmar import within_extent
from cei_gym.functional.representation import FunctionalRepresentation, pad_mesh
from cei_gym.kinematics.tree import KinematicTree

_POSES = 11  # from open to closed, where opposition is looked for
_LEAST_OPPOSITION_RAD = 0.7  # between the mean normals of two sides that close on each other


def opposing_sides(representation: FunctionalRepresentation, tree: KinematicTree) -> Array | None:
    """(N,) side, 0 or 1, of each pair: pads whose normals face each other somewhere between open and closed.

    Returns:
        None where no two pads close on each other.
    """
    embodiment = representation.embodiment
    share = np.linspace(0, 1, _POSES)[:, None]
    qpos = np.repeat(embodiment.home[None], _POSES, axis=0)
    hand = slice(embodiment.n_arm, None)
    qpos[:, hand] += share * (embodiment.closed - embodiment.home)[hand]
    _, normals = representation.place(tree.forward(qpos))
    bodies, pad = np.unique(representation.body, return_inverse=True)
    mean = np.stack([normals[:, pad == i].mean(axis=1) for i in range(len(bodies))], axis=1)
    mean /= np.linalg.norm(mean, axis=2, keepdims=True)
    spread = mean - mean.mean(axis=1, keepdims=True)
    widest = np.square(spread).sum(axis=(1, 2)).argmax()
    mean, spread = mean[widest], spread[widest]
    along = spread @ np.linalg.svd(spread, full_matrices=False)[2][0]
    side = (along > 0) != (along[0] > 0)
    if not side.any():
        return None
    one, two = mean[~side].mean(axis=0), mean[side].mean(axis=0)
    cosine = one @ two / (np.linalg.norm(one) * np.linalg.norm(two))
    return side[pad].astype(np.int64) if cosine < np.cos(_LEAST_OPPOSITION_RAD) else None


@dataclass(frozen=True)
class PadShapes:
    """The pads of an end-effector as convex shapes: what of them can touch.

    Attributes:
        body: (P,) link of each pad.
        side: (P,) 0 or 1.
        vertices_link: for each, (V, 3) outermost vertices in the link's frame, m.
    """

    body: Array
    side: Array
    vertices_link: list[Array]

    def place(self, T_links: Array) -> list[Array]:
        """For each pad (T, V, 3) vertices, m, in the frame of the links' poses (T, L, 4, 4)."""
        return [
            np.einsum("tij,vj->tvi", T_links[:, body, :3, :3], vertices) + T_links[:, body, None, :3, 3]
            for body, vertices in zip(self.body, self.vertices_link, strict=True)
        ]


def pad_shapes(representation: FunctionalRepresentation, sides: Array) -> PadShapes:
    """The shapes of a representation's pads, with (N,) sides of its pairs: of each link only the part that is pad."""
    embodiment = representation.embodiment
    assert embodiment.end_effector is not None
    pads = embodiment.end_effector.pads
    body = np.array([embodiment.body_id(pad.body) for pad in pads])
    side = np.array([sides[representation.body == b][0] for b in body])
    surfaces = [within_extent(pad_mesh(embodiment, pad), pad.extent) for pad in pads]
    return PadShapes(body, side, [outermost(np.asarray(surface.vertices)) for surface in surfaces])
