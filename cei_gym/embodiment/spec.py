"""The small typed YAML of an arm and of an end-effector."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import draccus
import yaml

from cei_gym.errors import CEIError, one_line


@dataclass(frozen=True)
class Coupling:
    """One joint that follows another: `q_follower = scale * q_leader + offset`.

    Attributes:
        joint: the leader.
        scale: rad/rad (or m/m).
        offset: rad (or m).
        ignore_limits: the follower's own limits do not bind (say why beside it in the YAML).
    """

    joint: str
    scale: float = 1.0
    offset: float = 0.0
    ignore_limits: bool = False


@dataclass(frozen=True)
class Pad:
    """One finger pad: the palmar side of some geoms of a link.

    Attributes:
        body: link that carries the pad.
        geoms: geoms whose surface is sampled; empty means all collision geoms of the body.
        share: how many points it gets, relative to the other pads.
        extent: part of the link's length that counts as pad, from its base (0) to its tip (1).
        palmar: "auto" (the side that leads when the hand closes), or a direction in the link's frame.
        palmar_cosine: least cosine between a surface normal and the palmar direction.
    """

    body: str
    geoms: list[str] = field(default_factory=list)
    share: float = 1.0
    extent: list[float] = field(default_factory=lambda: [0.0, 1.0])
    palmar: str | list[float] = "auto"
    palmar_cosine: float = 0.8


@dataclass(frozen=True)
class PhysicsException:
    """A departure from the physics that the simulator ships, with its reason.

    Attributes:
        kind: what is changed. "mount" (the mount below instead of the description's own) and "geom_mass" concern the
            body and hold everywhere; the simulator's package knows the others.
        reason: why, in one sentence; printed in every report.
        enabled: the switch.
        required: whether nothing works without it, so that it also holds where stock physics are asked for.
        parameters: numbers and names that the kind needs.
    """

    kind: str
    reason: str
    enabled: bool = True
    required: bool = False
    parameters: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ArmSpec:
    """An arm: description, flange and home pose (rad).

    Attributes:
        mount_body: the flange.
        root_body: subtree that is the arm, its first frame the base; empty means all of the description.
        joints: those of the description that are the arm's; others are held where they are drawn; empty means all.
        inertia_groups: first and last group of the geoms that have mass, where the description leaves that to the file
            that includes it.
        max_velocity: largest speed of joints, rad/s or m/s; the others have their URDF's, or a default.
        simulator_name: the simulator's name for it, if it differs.
    """

    name: str
    description: str
    mount_body: str
    home: dict[str, float]
    max_velocity: dict[str, float] = field(default_factory=dict)
    root_body: str = ""
    joints: list[str] = field(default_factory=list)
    inertia_groups: list[int] = field(default_factory=list)
    simulator_name: str = ""
    physics: list[PhysicsException] = field(default_factory=list)


@dataclass(frozen=True)
class EndEffectorSpec:
    """An end-effector: description, mount, couplings, poses and pads.

    Attributes:
        root_body: subtree to attach; empty means the description's first body.
        angle: "radian" or "degree" where the description does not say (MJCF then means degrees).
        inertia_groups: as for an arm.
        mount_pos_m, mount_quat_wxyz: pose of the root body on the flange; empty keeps the description's own.
        home: rest pose of independent joints (others 0); joints that move no pad stay there.
        closed: closed pose of independent joints; home to closed tells which side of a finger is palmar.
        max_velocity: as for an arm.
        compliance: how many times as far fingers are sent into an object for the same grip, where joints without a motor
            give way.
        simulator_name: the simulator's name for it, if it differs.
    """

    name: str
    description: str
    pads: list[Pad]
    home: dict[str, float] = field(default_factory=dict)
    closed: dict[str, float] = field(default_factory=dict)
    max_velocity: dict[str, float] = field(default_factory=dict)
    compliance: float = 1.0
    root_body: str = ""
    angle: str = ""
    inertia_groups: list[int] = field(default_factory=list)
    mount_pos_m: list[float] = field(default_factory=list)
    mount_quat_wxyz: list[float] = field(default_factory=list)
    couplings: dict[str, Coupling] = field(default_factory=dict)
    simulator_name: str = ""
    physics: list[PhysicsException] = field(default_factory=list)


def load_spec[Spec](cls: type[Spec], path: Path) -> Spec:
    """Read one YAML file into a typed specification; any fault is one line with the file's name."""
    try:
        raw = yaml.safe_load(path.read_text())
        if not isinstance(raw, Mapping):
            raise CEIError("expected a mapping of fields")
        return draccus.decode(cls, raw)
    except FileNotFoundError:
        raise CEIError(f"no such file: {path}.") from None
    except Exception as error:
        raise CEIError(f"{path.name}: not a valid {cls.__name__}: {one_line(error)}") from error
