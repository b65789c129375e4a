"""The functional representation of an embodiment: points and outward normals on its finger pads (section IV-A)."""

from dataclasses import dataclass

import numpy as np
import trimesh

from cei_gym.arrays import Array
from cei_gym.embodiment.embodiment import Embodiment
from cei_gym.embodiment.meshes import collision_geoms, link_mesh
from cei_gym.embodiment.spec import Pad
from cei_gym.errors import CEIError, unknown
from cei_gym.functional.palmar import extent_mask, outer_mask, palmar_directions
from cei_gym.kinematics.tree import KinematicTree

_MOST_TRIANGLES = 500_000

VARIANTS = ("standard", "reduced", "dropped")
"""Which part of a pad stands for it: all of it, the quarter of its area around its centroid (half its extent), or a
random half of the standard's points (the paper's "Sensitivity of functional representation")."""


@dataclass(frozen=True)
class FunctionalRepresentation:
    """N point-normal pairs fixed to the links of an embodiment.

    Attributes:
        embodiment: whose pads these are.
        body: (N,) link of each pair.
        points_link: (N, 3) points in their link's frame, m.
        normals_link: (N, 3) outward unit normals in their link's frame.
    """

    embodiment: Embodiment
    body: Array
    points_link: Array
    normals_link: Array

    def __len__(self) -> int:
        return len(self.body)

    def place(self, T_links: Array) -> tuple[Array, Array]:
        """Pairs in the frame in which the links are posed.

        Args:
            T_links: (..., L, 4, 4) link poses (`KinematicTree.forward`, or those in the world).

        Returns:
            Points (..., N, 3) in m and unit normals (..., N, 3).
        """
        T = T_links[..., self.body, :, :]
        points = np.einsum("...nij,nj->...ni", T[..., :3, :3], self.points_link) + T[..., :3, 3]
        return points, np.einsum("...nij,nj->...ni", T[..., :3, :3], self.normals_link)


def sample_representation(
    embodiment: Embodiment, points: int = 64, seed: int = 0, variant: str = "standard"
) -> FunctionalRepresentation:
    """Sample an embodiment's pads, area-uniform on each pad, seeded.

    Args:
        embodiment: whose end-effector's YAML names the pads.
        points: pairs in all, shared among pads by their `share` ("dropped" keeps half of each pad's, rounded up).
        seed: of the sampling.
        variant: one of `VARIANTS`.

    Raises:
        CEIError: no pads, a pad that names what the model lacks, one with no palmar surface, or no such variant.
    """
    if variant not in VARIANTS:
        raise unknown("variant of the functional representation", variant, VARIANTS)
    spec = embodiment.end_effector
    if spec is None or not spec.pads:
        raise CEIError(f"{embodiment.name} has no finger pads; list them under `pads` in its end-effector's YAML.")
    shares = np.array([pad.share for pad in spec.pads], float)
    if not ((shares > 0) & (shares < np.inf)).all():
        raise CEIError(f"each pad's `share` in {embodiment.name} must be finite and above 0, not {shares.tolist()}.")
    ends = np.round(np.cumsum(shares) / shares.sum() * points).astype(int)
    counts = np.diff(ends, prepend=0)
    tree = KinematicTree(embodiment)
    parts = [
        _sample_variant(embodiment, tree, pad, int(count), np.random.default_rng([seed, i]), variant)
        for i, (pad, count) in enumerate(zip(spec.pads, counts, strict=True))
    ]
    bodies = [np.full(len(p), embodiment.body_id(pad.body)) for pad, (p, _) in zip(spec.pads, parts, strict=True)]
    return FunctionalRepresentation(
        embodiment,
        np.concatenate(bodies),
        np.concatenate([p for p, _ in parts]),
        np.concatenate([n for _, n in parts]),
    )


def pad_mesh(embodiment: Embodiment, pad: Pad) -> trimesh.Trimesh:
    """The surface that a pad is a part of, in its link's frame."""
    model, body = embodiment.model, embodiment.body_id(pad.body)
    available = {model.geom(g).name.split("/")[-1]: int(g) for g in np.flatnonzero(model.geom_bodyid == body)}
    for geom in pad.geoms:
        if geom not in available:
            raise unknown(f"geom of pad {pad.body!r} of {embodiment.name}", geom, available)
    geoms = [available[g] for g in pad.geoms] or list(collision_geoms(model, body))
    mesh = link_mesh(model, geoms)
    if mesh is None:
        raise CEIError(
            f"pad {pad.body!r} of {embodiment.name}: the link has no collision geom; name its `geoms`: {', '.join(available)}."
        )
    if len(mesh.faces) > _MOST_TRIANGLES:
        raise CEIError(
            f"pad {pad.body!r} of {embodiment.name}: its geoms have {len(mesh.faces)} triangles, which takes minutes to look through; name"
            " only those that touch objects under `geoms`."
        )
    return mesh


def _sample_variant(
    embodiment: Embodiment, tree: KinematicTree, pad: Pad, count: int, rng: np.random.Generator, variant: str
) -> tuple[Array, Array]:
    points, normals = _sample_pad(embodiment, tree, pad, 4 * count if variant == "reduced" else count, rng)
    kept = np.arange(len(points))
    if variant == "reduced":
        kept = np.argsort(np.linalg.norm(points - points.mean(axis=0), axis=1))[:count]
    elif variant == "dropped":
        kept = rng.choice(count, (count + 1) // 2, replace=False)
    return points[kept], normals[kept]


def _sample_pad(embodiment: Embodiment, tree: KinematicTree, pad: Pad, count: int, rng: np.random.Generator):
    mesh = pad_mesh(embodiment, pad)
    found_points, found_normals, found = [], [], 0
    # The palmar side is a part of the surface: keep drawing until it has enough of an area-uniform sample.
    for _ in range(20):
        points, faces = trimesh.sample.sample_surface(mesh, 64 * count, seed=int(rng.integers(2**31)))[:2]
        points, normals = np.asarray(points), mesh.face_normals[faces]
        directions = palmar_directions(embodiment, tree, pad, points)
        keep = np.einsum("ij,ij->i", normals, directions) > pad.palmar_cosine
        keep &= extent_mask(mesh, pad.extent, points)
        points, normals = points[keep], normals[keep]
        outer = outer_mask(mesh, points, normals)
        found_points.append(points[outer])
        found_normals.append(normals[outer])
        found += int(outer.sum())
        if found >= count:
            return np.concatenate(found_points)[:count], np.concatenate(found_normals)[:count]
    raise CEIError(
        f"pad {pad.body!r} of {embodiment.name}: almost no surface faces its palmar side (cosine > {pad.palmar_cosine}); "
        "set `palmar` to a direction in the link's frame, or lower `palmar_cosine`."
    )
