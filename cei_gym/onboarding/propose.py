"""From a description to the specifications of what is in it."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.embodiment import ArmSpec, Embodiment, EndEffectorSpec
from cei_gym.embodiment.description import Description, doubtful_units, load_description
from cei_gym.embodiment.resources import locate, packages_beside
from cei_gym.errors import CEIError
from cei_gym.onboarding.arm import guess_arm
from cei_gym.onboarding.hand import guess_hand
from cei_gym.onboarding.structure import Part, find_parts

_SIDES = {"Left": re.compile(r"left|(^|[ _])l_"), "Right": re.compile(r"right|(^|[ _])r_")}


@dataclass(frozen=True)
class Proposal:
    """A specification that was found, and what of it is a guess.

    Attributes:
        spec: of an arm or an end-effector.
        embodiment: compiled from it.
        unsure: why something is a guess, by the YAML's field.
        notes: what else is to say of it.
    """

    spec: ArmSpec | EndEffectorSpec
    embodiment: Embodiment
    unsure: dict[str, str]
    notes: list[str]


def propose(
    description: str,
    folder: Path,
    kind: str = "",
    name: str = "",
    root: str = "",
    xacro_args: Mapping[str, str] | None = None,
    named: Callable[[list[tuple[str, str]]], None] = lambda _: None,
) -> list[Proposal]:
    """What a description's arms and end-effectors are, arms first.

    Args:
        description: as in a YAML: a path, or `package://`.
        folder: that a relative path starts from.
        kind: "arm", "end_effector", "both", or "" to find out.
        name: of what is found; "" is the file's.
        root: link to begin at; "" is the first.
        xacro_args: of a xacro.
        named: called with kind and name of all that will be found, before the work.

    Raises:
        CEIError: the description is refused, or nothing of that kind is in it.
    """
    arguments = dict(xacro_args or {})
    place = locate(description, folder, [folder], packages_beside(folder, []))
    read = load_description(place, xacro_args=arguments)
    parts, left_out = find_parts(read.spec, kind, root)
    names = _names(name or _stem(description), parts)
    named([(part.kind, own) for part, own in zip(parts, names, strict=True)])
    angle = "radian" if any("if these are radians" in note for note in doubtful_units(read.spec)) else ""
    flanges: dict[str, Array] = {}
    found: list[Proposal] = []
    failed = [f"the joints to link {end!r} are no arm with a hand at its end" for end in left_out]
    # Hands first: where one is mounted tells where its arm's flange is.
    for part, own in sorted(zip(parts, names, strict=True), key=lambda each: each[0].kind, reverse=True):
        unsure = {"angle": "it does not say, and in degrees nothing would move by more than a few"} if angle else {}
        joints = part.joints if part.beside else []
        if part.kind == "end_effector":
            spec = EndEffectorSpec(
                own, description, [], root_body=part.root_body, joints=joints, angle=angle, xacro_args=arguments
            )
            try:
                hand = guess_hand(spec, folder)
            except CEIError as error:
                failed.append(str(error))
                continue
            found.append(Proposal(hand.spec, hand.embodiment, unsure | hand.unsure, []))
            flanges[part.root_body] = _pose(hand.spec)
        else:
            spec = ArmSpec(
                own,
                description,
                part.mount_body,
                {},
                joints=joints,
                until_body=part.until_body,
                angle=angle,
                xacro_args=arguments,
            )
            at = _flange_of(read, part, flanges)
            arm = guess_arm(spec, folder, at)
            notes = [f"its flange is {arm.reach_m:.2f} m from its second joint, stretched"]
            found.append(Proposal(arm.spec, arm.embodiment, unsure | arm.unsure, notes))
    if not found:
        raise CEIError(failed[-1])
    found[0].notes.extend(f"left out: {why}" for why in failed)
    return sorted(found, key=lambda proposal: isinstance(proposal.spec, EndEffectorSpec))


def _stem(description: str) -> str:
    words = re.split(r"[^A-Za-z0-9]+", Path(description.rpartition(":")[2]).name.partition(".")[0])
    return "".join(word[:1].upper() + word[1:] for word in words if word) or "Robot"


def _names(name: str, parts: list[Part]) -> list[str]:
    if "-" in name or "/" in name:
        raise CEIError(f"--name={name}: names have no hyphen and no slash, as `<Arm>-<EndEffector>` is a robot.")
    kinds = {part.kind for part in parts}
    names = []
    for part in parts:
        several = sum(part.kind == other.kind for other in parts) > 1
        where = f"{part.root_body} {part.mount_body}".lower()
        side = next((side for side, words in _SIDES.items() if words.search(where)), "") if several else ""
        own = f"{name}{side}" + ("Hand" if len(kinds) > 1 and part.kind == "end_effector" else "")
        names.append(own if own not in names else f"{own}{len(names)}")
    return names


def _pose(spec: EndEffectorSpec) -> Array:
    """(4, 4) the first link on the flange."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(spec.mount_quat_wxyz, scalar_first=True).as_matrix()
    T[:3, 3] = spec.mount_pos_m
    return T


def _flange_of(read: Description, part: Part, T_flange_roots: dict[str, Array]) -> Array | None:
    """(4, 4) where the hand in the same file says that the flange is, in the frame of its link."""
    if part.until_body not in T_flange_roots:
        return None
    T_mount_root = np.eye(4)
    if part.until_body != part.mount_body:
        root = read.spec.body(part.until_body)
        T_mount_root[:3, :3] = Rotation.from_quat(root.quat, scalar_first=True).as_matrix()
        T_mount_root[:3, 3] = root.pos
    return T_mount_root @ np.linalg.inv(T_flange_roots[part.until_body])


def with_description(proposal: Proposal, description: str) -> Proposal:
    """The same, of a description by another path."""
    return replace(proposal, spec=replace(proposal.spec, description=description, folder=""))
