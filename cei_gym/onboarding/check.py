"""What is wrong with an arm's or an end-effector's YAML, in plain words."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.alignment.contact.pads import opposing_sides
from cei_gym.arrays import Array
from cei_gym.embodiment import ArmSpec, Embodiment, EndEffectorSpec, build_embodiment
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.errors import CEIError
from cei_gym.functional.representation import FunctionalRepresentation, sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.onboarding.arm import flange
from cei_gym.onboarding.overlaps import Overlaps

_POINTS = 128
_POSES = 21
_SHUT_M = 0.015  # pads that stay farther apart hold nothing small
_OPEN_M = 0.04  # the cube of PickCube
_ALIKE = 0.005
_FACING = np.cos(np.radians(60))
_SIX = 6
_TIGHT = 0.01  # rad or m of room to a limit
_ARM_KG, _HAND_KG = (0.2, 150.0), (0.01, 6.0)
_ARM_M, _HAND_M = (0.15, 2.5), (0.03, 0.7)


@dataclass(frozen=True)
class Finding:
    """Something to know of a robot.

    Attributes:
        wrong: whether it has to be mended; else it is worth a look.
        text: a sentence or two: what, where, what would be right.
    """

    wrong: bool
    text: str


def check_arm(spec: ArmSpec, folder: Path = Path()) -> list[Finding]:
    """What is wrong with an arm, or worth a look.

    Args:
        spec: its specification.
        folder: that a relative description starts from, if not the one it was read from.
    """
    return _findings(lambda: build_embodiment(spec, None, folder), lambda arm: _of_arm(spec, arm))


def check_end_effector(spec: EndEffectorSpec, folder: Path = Path()) -> list[Finding]:
    """What is wrong with an end-effector, or worth a look.

    Args:
        spec: its specification.
        folder: that a relative description starts from, if not the one it was read from.
    """
    return _findings(lambda: build_embodiment(None, spec, folder), lambda hand: _of_hand(spec, hand))


def pad_gap_m(representation: FunctionalRepresentation, sides: Array) -> Array:
    """(T,) between the pads of two sides from home to closed, along the way they face, m; negative where they have passed each other.

    Args:
        representation: of an end-effector.
        sides: (N,) 0 or 1, of `opposing_sides`.
    """
    embodiment = representation.embodiment
    share = np.linspace(0, 1, _POSES)[:, None]
    qpos = (1 - share) * embodiment.home + share * embodiment.closed
    points, normals = representation.place(KinematicTree(embodiment).forward(qpos))
    one, two = sides == 0, sides == 1
    across = normals[:, one].mean(axis=1) - normals[:, two].mean(axis=1)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    along = np.einsum("tni,ti->tn", points, across)
    return np.median(along[:, two], axis=1) - np.median(along[:, one], axis=1)


def _findings(build: Callable[[], Embodiment], judge: Callable[[Embodiment], Iterator[Finding]]) -> list[Finding]:
    try:
        embodiment = build()
        found = list(judge(embodiment))
    except CEIError as error:
        return [Finding(True, str(error))]
    notes = [note.removeprefix(f"{embodiment.name}: ") for note in embodiment.notes]
    doubtful = ("degrees", "millimetres", "no room to move")
    found += [Finding(any(word in note for word in doubtful), note) for note in notes]
    return sorted(found, key=lambda finding: not finding.wrong)


def _of_arm(spec: ArmSpec, arm: Embodiment) -> Iterator[Finding]:
    tree = KinematicTree(arm)
    mount = arm.body_id(spec.mount_body)
    given = np.eye(3)
    if spec.mount_quat_wxyz:
        given = Rotation.from_quat(spec.mount_quat_wxyz, scalar_first=True).as_matrix()
    found, said = flange(arm, tree, mount)
    cosine = float(given[:, 2] @ found[:3, 2])
    if (said and not spec.mount_quat_wxyz) or cosine < -_FACING:
        quat = Rotation.from_matrix(found[:3, :3]).as_quat(scalar_first=True).round(4).tolist()
        backwards = "points backwards, into the arm" if cosine < -_FACING else "does not point out of the arm"
        yield Finding(
            cosine < -_FACING,
            f"the flange's z {backwards} along its last joint; an end-effector would be mounted so. `mount_quat_wxyz: {quat}` would be right.",
        )
    overlaps = Overlaps(arm)
    for (name, other), depth_m in overlaps.at(arm.home).items():
        deep, by_design = f"{name!r} is {1e3 * depth_m:.0f} mm deep in {other!r}", (name, other) in overlaps.by_design
        yield Finding(
            not by_design,
            f"{deep} in most poses, at home too: their shapes overlap by design."
            if by_design
            else f"at home {deep}; choose another `home`.",
        )
    independent = arm.coupled.independent
    if len(independent) < _SIX:
        yield Finding(
            False,
            f"{len(independent)} joints reach no pose of six dimensions: a demonstration's poses can be followed in part only, many not at all.",
        )
    yield from _limits(arm)
    yield from _scale(arm, _ARM_KG, _ARM_M)


def _of_hand(spec: EndEffectorSpec, hand: Embodiment) -> Iterator[Finding]:
    tree = KinematicTree(hand)
    if np.allclose(hand.home, hand.closed):
        yield Finding(True, "`closed` is where `home` is: say under `closed` which joints close it, and how far.")
        return
    representation = sample_representation(hand, _POINTS)
    sides = opposing_sides(representation, tree)
    if sides is None:
        yield Finding(
            True,
            "no pads face each other anywhere between `home` and `closed`; look at them (cei-robot show), and mend `pads`, `home` or `closed`.",
        )
        return
    yield from _closing(representation, sides)
    yield from _alone(representation, tree, sides)
    T = tree.forward((hand.home + hand.closed) / 2)
    points, _ = representation.place(T)
    if points[:, 2].mean() < T[hand.end_effector_root, 2, 3] - 1e-3 and points[:, 2].mean() < 0:
        yield Finding(
            True, "its pads lie behind the flange, whose z points out of the arm: turn it with `mount_quat_wxyz`."
        )
    yield from _scale(hand, _HAND_KG, _HAND_M)


def _closing(representation: FunctionalRepresentation, sides: Array) -> Iterator[Finding]:
    gap = pad_gap_m(representation, sides)
    if gap[0] <= 0:
        yield Finding(
            True,
            "its pads look away from each other: they are where its links lead as it closes; are `home`, which is open, and `closed` swapped?",
        )
        return
    if gap[-1] > gap[0]:
        yield Finding(
            True,
            f"its pads part as it closes, from {1e3 * gap[0]:.0f} to {1e3 * gap[-1]:.0f} mm: `home` is open and `closed` is shut; are they swapped?",
        )
        return
    if gap.min() > _SHUT_M:
        yield Finding(
            False,
            f"closed, its pads are still {1e3 * gap.min():.0f} mm apart: nothing thinner can be held; may `closed` go on?",
        )
    if gap.max() < _OPEN_M:
        yield Finding(
            False, f"it opens by {1e3 * gap.max():.0f} mm: no more than such objects can be held; may `home` be wider?"
        )


def _alone(representation: FunctionalRepresentation, tree: KinematicTree, sides: Array) -> Iterator[Finding]:
    """Pads that face none of the other side, wherever the end-effector is on its way."""
    hand = representation.embodiment
    share = np.linspace(0, 1, _POSES)[:, None]
    _, normals = representation.place(tree.forward((1 - share) * hand.home + share * hand.closed))
    for body in np.unique(representation.body):
        own = representation.body == body
        side = sides[own][0]
        mine, theirs = normals[:, own].mean(axis=1), normals[:, sides != side].mean(axis=1)
        cosine = (mine * theirs).sum(axis=1) / np.linalg.norm(mine, axis=1) / np.linalg.norm(theirs, axis=1)
        if cosine.min() > -_ALIKE:
            yield Finding(
                True,
                f"the pad on {hand.link_names[body]!r} opposes nothing: it turns away from the others by at most {np.degrees(np.arccos(np.clip(cosine.min(), -1, 1))):.0f} degrees on the way.",
            )


def _limits(arm: Embodiment) -> Iterator[Finding]:
    room = np.minimum(arm.home - arm.lower, arm.upper - arm.home)[arm.coupled.independent]
    for q in arm.coupled.independent[room < _TIGHT]:
        yield Finding(
            False,
            f"`home` has {arm.joint_names[q]!r} at its limit; a solver that starts there has half its ways.",
        )


def _scale(embodiment: Embodiment, mass_kg: tuple[float, float], size_m: tuple[float, float]) -> Iterator[Finding]:
    kg = float(mujoco.mj_getTotalmass(embodiment.model))
    if not mass_kg[0] <= kg <= mass_kg[1]:
        yield Finding(False, f"it weighs {kg:.3g} kg, where {mass_kg[0]:g} to {mass_kg[1]:g} would be usual.")
    T = KinematicTree(embodiment).forward(embodiment.home)
    meshes = [(b, mesh) for b, mesh in enumerate(visual_link_meshes(embodiment.model)) if mesh is not None]
    if not meshes:
        return
    points = np.concatenate([np.asarray(mesh.bounds) @ T[b, :3, :3].T + T[b, :3, 3] for b, mesh in meshes])
    extent = float(np.ptp(points, axis=0).max())
    if not size_m[0] <= extent <= size_m[1]:
        yield Finding(
            True,
            f"it is {extent:.3g} m large, where {size_m[0]:g} to {size_m[1]:g} would be usual; are its meshes in another unit?",
        )
