"""The small typed YAML of an arm and of an end-effector."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any, ClassVar

import draccus

from cei_gym.embodiment.checked import Checked
from cei_gym.embodiment.servo import OF_ARMS, OF_END_EFFECTORS, Servo
from cei_gym.errors import CEIError, one_line, unknown
from cei_gym.untrusted import load_yaml


@dataclass(frozen=True)
class Coupling(Checked):
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


class _Part(Checked):
    """What an arm and an end-effector have in common."""

    SELF_CONTACT: ClassVar[tuple[str, ...]]
    """What `self_contact` can be."""

    name: str
    description: str
    max_velocity: dict[str, float]
    inertia_groups: list[int]
    angle: str
    self_contact: str
    couplings: dict[str, Coupling]
    joints: list[str]
    package_path: list[str]
    xacro_args: dict[str, Any]
    mount_pos_m: list[float]
    mount_quat_wxyz: list[float]
    folder: str

    def __post_init__(self) -> None:
        for joint, speed in self.max_velocity.items():
            if speed is None or not 0 < speed < inf:
                raise CEIError(f"max_velocity of {self.name} gives {joint} {speed}; it must be finite and above 0.")
        groups = self.inertia_groups
        if groups and (len(groups) != 2 or not 0 <= groups[0] <= groups[1] <= 5):
            raise CEIError(f"`inertia_groups` of {self.name} should be two of 0 to 5, not {groups}.")
        if self.angle not in ("", "radian", "degree"):
            raise unknown(f"angle of {self.name}", self.angle, ["radian", "degree"])
        if self.self_contact not in self.SELF_CONTACT:
            raise unknown(f"self_contact of {self.name}", self.self_contact, self.SELF_CONTACT)
        if len(self.mount_pos_m) not in (0, 3):
            raise CEIError(f"`mount_pos_m` of {self.name} should be 3 numbers, not {self.mount_pos_m}.")
        if self.mount_quat_wxyz and (len(self.mount_quat_wxyz) != 4 or not any(self.mount_quat_wxyz)):
            raise CEIError(f"`mount_quat_wxyz` of {self.name} should be 4 numbers, not {self.mount_quat_wxyz}.")
        for name, value in self.xacro_args.items():
            if not isinstance(value, (str, int, float)):
                raise CEIError(
                    f"xacro_args of {self.name} gives {name} {value}; it should be a text, a number or a truth."
                )
        super().__post_init__()


@dataclass(frozen=True)
class Pad(Checked):
    """One finger pad: the palmar side of some geoms of a link.

    Attributes:
        body: link that carries the pad.
        geoms: geoms whose surface is sampled, by name, or `<link>.<number>`, from 0, where they have none; empty means all
            collision geoms of the body.
        share: how many points it gets, relative to the other pads.
        extent: part of the link's length that counts as pad, from its base (0) to its tip (1), the end farther from its joint.
        palmar: "auto" (the side that leads when the hand closes), or a direction in the link's frame.
        palmar_cosine: least cosine between a surface normal and the palmar direction.
    """

    body: str
    geoms: list[str] = field(default_factory=list[str])
    share: float = 1.0
    extent: list[float] = field(default_factory=lambda: [0.0, 1.0])
    palmar: list[float] | str = "auto"  # in this order: anything can be read as a str
    palmar_cosine: float = 0.8


@dataclass(frozen=True)
class PhysicsException(Checked):
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
    parameters: dict[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class ArmSpec(_Part):
    """An arm: description, flange and home pose (rad).

    Attributes:
        name: that of the file; no hyphen.
        description: path of the MJCF, URDF or xacro, from the YAML's folder, `package://<package>/<path>`,
            `robot_descriptions:<name>` or `mujoco_menagerie:<name>`.
        mount_body: the flange's link.
        mount_pos_m, mount_quat_wxyz: pose of the flange in that link; empty is its frame. Flanges' z points out of the arm.
        home: joint to its rest position, rad or m.
        physics: departures from the simulator's physics.
        root_body: subtree that is the arm, its first frame the base; empty means all of the description.
        joints: those of the description that are the arm's; others are held where they are drawn; empty means all.
        until_body: the first link that is an end-effector's and no more the arm's, where one file has both; what hangs on it goes with it,
            but if it is `mount_body` its frame and joint stay.
        leave_out: links that are no part of it, with what hangs on them: a humanoid's head and its other arm, say.
        inertia_groups: first and last group of the geoms that have mass, where the description leaves that to the file
            that includes it.
        max_velocity: largest speed of joints, rad/s or m/s; the others have their URDF's, or a default.
        simulator_name: the simulator's name for it, if it differs.
        angle: "radian" or "degree" where the description does not say (MJCF then means degrees).
        couplings: follower -> which joint it follows, where the description does not say, or says it otherwise.
        package_path: folders below the YAML's own that ROS packages are looked for in; `--package_path` gives others.
        xacro_args: argument of a xacro -> its value, instead of its default.
        servo: how joints are driven where the simulator has no controller of its own.
        remark: what it is good for, or what it cannot; `cei-robot list` shows it.
        self_contact: which of its links touch each other there: "none", or "all" but neighbours and those that overlap at home.
        folder: of the YAML; `load_spec` fills it in.
    """

    SELF_CONTACT: ClassVar[tuple[str, ...]] = ("none", "all")

    name: str
    description: str
    mount_body: str
    home: dict[str, float]
    mount_pos_m: list[float] = field(default_factory=list[float])
    mount_quat_wxyz: list[float] = field(default_factory=list[float])
    max_velocity: dict[str, float] = field(default_factory=dict[str, float])
    root_body: str = ""
    joints: list[str] = field(default_factory=list[str])
    until_body: str = ""
    leave_out: list[str] = field(default_factory=list[str])
    inertia_groups: list[int] = field(default_factory=list[int])
    simulator_name: str = ""
    physics: list[PhysicsException] = field(default_factory=list[PhysicsException])
    angle: str = ""
    couplings: dict[str, Coupling] = field(default_factory=dict[str, Coupling])
    package_path: list[str] = field(default_factory=list[str])
    xacro_args: dict[str, Any] = field(default_factory=dict[str, Any])
    servo: Servo = OF_ARMS
    remark: str = ""
    self_contact: str = "none"
    folder: str = ""


@dataclass(frozen=True)
class EndEffectorSpec(_Part):
    """An end-effector: description, mount, couplings, poses and pads.

    Attributes:
        name, description: as for an arm.
        pads: of its fingers.
        physics: departures from the simulator's physics.
        root_body: subtree to attach; empty means the description's first body.
        joints: those of the subtree that are the end-effector's; others are held where they are drawn; empty means all.
        angle: "radian" or "degree" where the description does not say (MJCF then means degrees).
        inertia_groups: as for an arm.
        mount_pos_m, mount_quat_wxyz: pose of the root body on the flange; empty keeps the description's own.
        home: rest pose of independent joints (others 0); joints that move no pad stay there.
        closed: closed pose of independent joints; home to closed tells which side of a finger is palmar.
        max_velocity: as for an arm.
        compliance: how many times as far fingers are sent into an object for the same grip, where joints without a motor
            give way.
        couplings: as for an arm.
        simulator_name: the simulator's name for it, if it differs.
        package_path, xacro_args, servo, remark, folder: as for an arm.
        self_contact: as for an arm, or "fingers": links of different fingers alone. An arm touches it if both say "all".
    """

    SELF_CONTACT: ClassVar[tuple[str, ...]] = ("none", "fingers", "all")

    name: str
    description: str
    pads: list[Pad]
    home: dict[str, float] = field(default_factory=dict[str, float])
    closed: dict[str, float] = field(default_factory=dict[str, float])
    max_velocity: dict[str, float] = field(default_factory=dict[str, float])
    compliance: float = 1.0
    root_body: str = ""
    joints: list[str] = field(default_factory=list[str])
    angle: str = ""
    inertia_groups: list[int] = field(default_factory=list[int])
    mount_pos_m: list[float] = field(default_factory=list[float])
    mount_quat_wxyz: list[float] = field(default_factory=list[float])
    couplings: dict[str, Coupling] = field(default_factory=dict[str, Coupling])
    simulator_name: str = ""
    physics: list[PhysicsException] = field(default_factory=list[PhysicsException])
    package_path: list[str] = field(default_factory=list[str])
    xacro_args: dict[str, Any] = field(default_factory=dict[str, Any])
    servo: Servo = OF_END_EFFECTORS
    remark: str = ""
    self_contact: str = "none"
    folder: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.compliance > 0:
            raise CEIError(f"`compliance` of {self.name} should be above 0, not {self.compliance}.")


def read_fields(path: Path) -> Mapping[str, Any]:
    """The fields of a YAML file as they are.

    Raises:
        CEIError: there is no such file, or it has no fields.
    """
    try:
        raw = load_yaml(path.read_text())
    except FileNotFoundError:
        raise CEIError(f"no such file: {path}.") from None
    except (OSError, ValueError) as error:
        raise CEIError(f"{path.name}: {one_line(error)}") from error
    if not isinstance(raw, Mapping):
        raise CEIError(f"{path.name}: expected a mapping of fields")
    return raw


def load_spec[Spec](cls: type[Spec], path: Path) -> Spec:
    """Read one YAML file into a typed specification; any fault is one line with the file's name."""
    try:
        raw = read_fields(path)
        if issubclass(cls, _Part) and "folder" in raw:
            raise CEIError("unknown field `folder`")
        spec: Any = draccus.decode(cls, raw)
        return replace(spec, folder=str(path.resolve().parent)) if issubclass(cls, _Part) else spec
    except FileNotFoundError:
        raise CEIError(f"no such file: {path}.") from None
    except Exception as error:
        own = error.__cause__  # draccus hides what a class itself says
        reason = one_line(own if isinstance(own, CEIError) else error)
        raise CEIError(f"{path.name}: not a valid {cls.__name__}: {reason}") from error
