"""Pads as they are edited by clicks on a robot's links: what a click meets, and which pads follow from it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cei_converters.robot.pads_block import Sourced
from cei_gym.arrays import Array
from cei_gym.embodiment import Embodiment, Pad
from cei_gym.embodiment.meshes import collision_geoms
from cei_gym.errors import CEIError
from cei_gym.functional.representation import FunctionalRepresentation, sample_representation

AUTO, CLICKED = "auto", "towards the clicked normal"
PALMAR = (AUTO, CLICKED)
"""Which way a pad faces."""

_DECIMALS = 3  # of directions, as they are written


@dataclass(frozen=True)
class Click:
    """A point of a link's surface.

    Attributes:
        body: index of the link.
        geom: index of its geom.
        normal_link: (3,) outward unit normal, in the link's frame.
    """

    body: int
    geom: int
    normal_link: Array


def first_hit(triangles: Array, origin: Array, direction: Array) -> tuple[int, float] | None:
    """The triangle that a ray meets first, from either side, and how far from its origin; None if it meets none.

    Args:
        triangles: (F, 3, 3) corners.
        origin, direction: (3,), in the same frame.
    """
    corner = triangles[:, 0]
    a, b = triangles[:, 1] - corner, triangles[:, 2] - corner
    h, s = np.cross(direction, b), origin - corner
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / np.einsum("ij,ij->i", a, h)
        u = scale * np.einsum("ij,ij->i", s, h)
        q = np.cross(s, a)
        v = scale * (q @ direction)
        along = scale * np.einsum("ij,ij->i", b, q)
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0)
    if not met.any():
        return None
    face = int(np.argmin(np.where(met, along, np.inf)))
    return face, float(along[face])


def outward_normal(triangle: Array, direction: Array) -> Array:
    """(3,) unit normal of a triangle (3, 3) on the side that a ray along `direction` comes from."""
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    return -np.sign(normal @ direction) * normal / np.linalg.norm(normal)


def geom_name(embodiment: Embodiment, geom: int) -> str:
    """A geom's name as pads have it."""
    return embodiment.model.geom(geom).name.rpartition("/")[2]


class PadEditor:
    """The pads of an end-effector while they are edited.

    Args:
        embodiment: with an end-effector.
    """

    def __init__(self, embodiment: Embodiment) -> None:
        assert embodiment.end_effector is not None
        self._embodiment, self._end_effector = embodiment, embodiment.end_effector
        self.pads: list[Sourced] = list(enumerate(embodiment.end_effector.pads))
        self.chosen: int | None = None
        self.follows_clicks = False  # whether a click says which way the chosen pad faces
        self._normals: dict[str, Array] = {}  # by link, where it was clicked last

    @property
    def pad(self) -> Pad | None:
        """The chosen one."""
        return None if self.chosen is None else self.pads[self.chosen][1]

    def names(self) -> list[str]:
        """What pads are called, no two the same."""
        return [f"{i + 1}: {pad.body or '(click on its link)'}" for i, (_, pad) in enumerate(self.pads)]

    def choose(self, index: int | None) -> None:
        """Edit another, or none."""
        self.chosen = index
        self.follows_clicks = self.pad is not None and self.pad.palmar != "auto"

    def add(self) -> None:
        """A new pad, without a link until one is clicked."""
        self.pads.append((None, Pad("")))
        self.choose(len(self.pads) - 1)

    def remove(self) -> None:
        """Take the chosen pad away."""
        if self.chosen is not None:
            del self.pads[self.chosen]
            self.choose(None)

    def change(self, *, extent: Sequence[float] | None = None, share: float | None = None) -> None:
        """Change numbers of the chosen pad."""
        pad = self._required()
        extent = pad.extent if extent is None else [round(end, _DECIMALS) for end in extent]
        self._put(replace(pad, extent=extent, share=pad.share if share is None else share))

    def face(self, palmar: str) -> None:
        """Have the chosen pad face as one of `PALMAR` says.

        Raises:
            CEIError: its link was not clicked yet; the next click on it will say.
        """
        pad = self._required()
        self.follows_clicks = palmar == CLICKED
        if not self.follows_clicks:
            self._put(replace(pad, palmar="auto"))
        elif pad.palmar == "auto":
            normal = self._normals.get(pad.body)
            if normal is None:
                raise CEIError("click on the pad's surface, where it should face outwards.")
            self._put(replace(pad, palmar=_rounded(normal)))

    def click(self, at: Click) -> None:
        """Have the chosen pad be where the click is.

        Another link becomes its link, with the geom as its only one. A geom of its own link is added, or taken away where it has it; the
        first of another kind (what touches, what is only seen) replaces those that it has. While clicks say which way the pad faces, none
        is taken away.

        Raises:
            CEIError: the link is not the end-effector's.
        """
        pad, embodiment = self._required(), self._embodiment
        if not embodiment.of_end_effector[at.body]:
            raise CEIError(f"{embodiment.link_names[at.body]} is a link of the arm; pads are on the end-effector's.")
        body, geom = embodiment.link_names[at.body], geom_name(embodiment, at.geom)
        self._normals[body] = at.normal_link
        if body != pad.body:
            geoms = [geom]
        elif geom not in pad.geoms:
            touching = {geom_name(embodiment, int(each)) for each in collision_geoms(embodiment.model, at.body)}
            geoms = [*(each for each in pad.geoms if (each in touching) == (geom in touching)), geom]
        else:
            geoms = [each for each in pad.geoms if each != geom or self.follows_clicks]
        palmar = _rounded(at.normal_link) if self.follows_clicks else "auto"
        self._put(replace(pad, body=body, geoms=geoms, palmar=palmar))

    def sample(self, index: int, points: int) -> FunctionalRepresentation:
        """Points and normals of one pad, as many as its share of `points` is.

        Raises:
            CEIError: there are none, and why.
        """
        pad = self.pads[index][1]
        if not pad.body:
            raise CEIError("click on the surface of the link that carries it.")
        total = sum(max(each.share, 0.0) for _, each in self.pads) or 1.0
        return sample_representation(self.embodiment([pad]), max(1, round(pad.share / total * points)))

    def finished(self) -> list[Sourced]:
        """The pads, to be saved.

        Raises:
            CEIError: one has no link yet, or there are none.
        """
        if not self.pads:
            raise CEIError("an end-effector without pads can do nothing; add one.")
        for i, (_, pad) in enumerate(self.pads):
            if not pad.body:
                raise CEIError(
                    f"pad {i + 1} has no link yet; click on the surface of the one that carries it, or remove the pad."
                )
        return self.pads

    def embodiment(self, pads: Sequence[Pad]) -> Embodiment:
        """The same robot with other pads."""
        return replace(self._embodiment, end_effector=replace(self._end_effector, pads=list(pads)))

    def _required(self) -> Pad:
        if self.pad is None:
            raise CEIError("no pad is chosen; choose one, or add one.")
        return self.pad

    def _put(self, pad: Pad) -> None:
        assert self.chosen is not None
        self.pads[self.chosen] = (self.pads[self.chosen][0], pad)


def _rounded(direction: Array) -> list[float]:
    return [round(float(x), _DECIMALS) + 0.0 for x in direction]
