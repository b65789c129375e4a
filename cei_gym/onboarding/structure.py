"""What a description is made of: chains of joints that are arms, and what forks at their ends, which are hands."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import mujoco
import numpy as np

from cei_gym.errors import CEIError, unknown

KINDS = ("arm", "end_effector", "both")
"""What of a description is wanted."""

_LEAST_ARM_JOINTS = 4  # fewer before a hand are its wrist
_LONGEST_HAND_M = 0.45  # from where its fingers part to their farthest joint; longer limbs are arms and legs
_JAW = re.compile(r"grip|jaw|finger|claw|thumb|pinch", re.IGNORECASE)
_FLANGES = ("tool0", "flange", "ee_link", "link_eef", "eef", "attachment", "right_hand", "link8", "tool", "ee")


@dataclass(frozen=True)
class Part:
    """A part of a description.

    Attributes:
        kind: "arm" or "end_effector".
        root_body: its first link; of an arm "" is all of the description.
        joints: its own, from base to tip.
        mount_body: an arm's flange.
        until_body: of an arm the first link that is no more its own; "" where there is none.
        beside: joints of the description that are not its own.
    """

    kind: str
    root_body: str
    joints: list[str]
    mount_body: str = ""
    until_body: str = ""
    beside: list[str] = field(default_factory=list[str])


def find_parts(spec: mujoco.MjSpec, kind: str = "", root: str = "") -> tuple[list[Part], list[str]]:
    """The arms and end-effectors of a description, and the ends of chains of joints that are neither, as of legs.

    Args:
        spec: the description.
        kind: one of `KINDS`; "" finds out.
        root: link to begin at; "" is the first.

    Raises:
        CEIError: nothing of that kind is there, or no such link.
    """
    if kind and kind not in KINDS:
        raise unknown("--as", kind, KINDS)
    start = spec.worldbody
    if root:
        start = spec.body(root)
        if start is None:
            raise unknown("--root", root, [body.name for body in spec.bodies])
    every = [joint.name for joint in start.find_all("joint")]
    if not every:
        raise CEIError("nothing of it moves: an arm or an end-effector has joints.")
    chains = list(_chains(start, []))
    whole = Part("end_effector", root or spec.worldbody.first_body().name, every)
    found = _with_hands(spec, chains, root) or _serial(spec, chains, kind, whole)
    kinds = {part.kind for part in found}
    if kind == "both" and len(kinds) == 1:
        only, other = ("an arm", "an end-effector") if kinds == {"arm"} else ("an end-effector", "an arm")
        raise CEIError(f"it is {only} without {other}; leave --as out.")
    if kind in ("arm", "end_effector"):
        found = [part for part in found if part.kind == kind] or (
            [whole] if kind == "end_effector" else _arms(spec, chains)
        )
    used = {joint for part in found for joint in part.joints}
    return found, [chain.end.name for chain in chains if not used & set(chain.joints)]


def _with_hands(spec: mujoco.MjSpec, chains: list["_Chain"], root: str) -> list[Part]:
    """Arms and hands of chains that end where a hand forks."""
    parts: list[Part] = []
    for chain in chains:
        if chain.fork is None:
            continue
        inside = [joint.name for limb in chain.fork.bodies for joint in limb.find_all("joint")]
        if len(chain.joints) < _LEAST_ARM_JOINTS:
            top = root or _top(chain.fork, chain.joints)
            parts.append(Part("end_effector", top, [*chain.joints, *inside]))
            continue
        first = _first_of_hand(chain.fork)
        parts += [_arm(spec, chain.joints, first, first), _hand(first, inside)]
    return parts


def _serial(spec: mujoco.MjSpec, chains: list["_Chain"], kind: str, whole: Part) -> list[Part]:
    """What a description without forks is: an arm, one with a jaw at its end, or a jaw."""
    if len(chains) > 1:
        return [whole] if kind == "end_effector" else _arms(spec, chains)
    (chain,) = chains
    jaw = _jaw(chain) if kind == "both" or _is_jaw(chain) else None
    if jaw is not None and len(chain.joints) > _LEAST_ARM_JOINTS:
        own = [joint.name for joint in jaw.find_all("joint")]
        arm = [name for name in chain.joints if name not in own]
        return [_arm(spec, arm, jaw.parent, jaw.parent), _hand(jaw.parent, own)]
    return [whole] if len(chain.joints) < _LEAST_ARM_JOINTS else _arms(spec, chains)


def _arms(spec: mujoco.MjSpec, chains: list["_Chain"]) -> list[Part]:
    """The one chain of joints there is, as an arm.

    Raises:
        CEIError: there are several.
    """
    if len(chains) > 1:
        ends = ", ".join(repr(each.end.name) for each in chains)
        raise CEIError(
            f"it has several chains of joints, to {ends}, and none of them ends in a hand; name the link to begin at (--root)."
        )
    return [_arm(spec, chains[0].joints, chains[0].end, None)]


@dataclass(frozen=True)
class _Chain:
    joints: list[str]
    end: mujoco.MjsBody
    fork: mujoco.MjsBody | None


def _moves(body: mujoco.MjsBody) -> bool:
    return bool(body.find_all("joint"))


def _chains(body: mujoco.MjsBody, joints: list[str]) -> Iterator[_Chain]:
    """From a link on: to where a hand forks, or to the end."""
    joints = [*joints, *(joint.name for joint in body.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE)]
    limbs = [child for child in body.bodies if _moves(child)]
    if not limbs:
        if joints:
            yield _Chain(joints, body, None)
    elif len(limbs) == 1:
        yield from _chains(limbs[0], joints)
    elif max(_length_m(limb) for limb in limbs) <= _LONGEST_HAND_M:
        yield _Chain(joints, body, body)
    else:
        for limb in limbs:
            yield from _chains(limb, [])


def _length_m(body: mujoco.MjsBody) -> float:
    """Along links, from a limb's first joint to its farthest one, and to where it begins."""
    own = float(np.linalg.norm(body.pos))
    return own + max((_length_m(child) for child in body.bodies if _moves(child)), default=0.0)


def _jaw(chain: _Chain) -> mujoco.MjsBody | None:
    """The link on a chain's last joint."""
    body = chain.end
    while not len(body.joints):
        body = body.parent
    return body


def _is_jaw(chain: _Chain) -> bool:
    body = _jaw(chain)
    return body is not None and any(_JAW.search(name) for name in (body.name, chain.joints[-1]))


def _top(fork: mujoco.MjsBody, joints: list[str]) -> str:
    """The link that a hand's own wrist hangs on, or its first: fixed ones up to it are its own."""
    body = fork
    while body.parent.name != "world" and not (
        any(joint.name not in joints for joint in body.parent.joints)
        or len([c for c in body.parent.bodies if _moves(c)]) > 1
    ):
        body = body.parent
    return body.name


def _first_of_hand(fork: mujoco.MjsBody) -> mujoco.MjsBody:
    """A hand begins where links that are called like it do."""
    body, stem = fork, re.split(r"[_\-. ]", fork.name)[0]
    while not len(body.joints) and not len(body.parent.joints) and body.parent.name.startswith(stem):
        body = body.parent
    return body


def _hand(root: mujoco.MjsBody, joints: list[str]) -> Part:
    beside = [joint.name for joint in root.joints]
    return Part("end_effector", root.name, joints, beside=beside)


def _arm(spec: mujoco.MjSpec, joints: list[str], end: mujoco.MjsBody, hand: mujoco.MjsBody | None) -> Part:
    beside = [joint.name for joint in spec.joints if joint.name not in joints]
    if hand is None:
        return Part("arm", "", joints, _flange(end).name, beside=beside)
    mount = hand if len(hand.joints) else hand.parent
    return Part("arm", "", joints, mount.name, hand.name, beside)


def _flange(last: mujoco.MjsBody) -> mujoco.MjsBody:
    """The fixed link that is called like a flange, of those on an arm's last; else the last."""
    fixed = [body for body in last.find_all("body") if not _moves(body)]
    for name in _FLANGES:
        for body in fixed:
            if body.name == name or body.name.endswith((f"_{name}", f"-{name}")):
                return body
    return last
