"""A specification as the YAML that a person goes on with: what each field is, its unit, and what of it is a guess."""

from collections.abc import Mapping, Sequence
from textwrap import wrap

import yaml

from cei_gym.embodiment import ArmSpec, Embodiment, EndEffectorSpec, Pad
from cei_gym.embodiment.building import DEFAULT_MAX_VELOCITY_M_S, DEFAULT_MAX_VELOCITY_RAD_S
from cei_gym.onboarding.propose import Proposal

_WIDTH = 110


def yaml_of(proposal: Proposal) -> str:
    """The YAML of a proposal."""
    spec, embodiment, unsure = proposal.spec, proposal.embodiment, proposal.unsure
    lines = [f"name: {_flow(spec.name)}", f"description: {_flow(spec.description)}"]

    def field(name: str, value: object, what: str) -> None:
        lines.extend(_unsure(unsure.get(name)))
        lines.append(f"{name}: {_flow(value)} # {what}")

    if spec.xacro_args:
        field("xacro_args", spec.xacro_args, "of the xacro")
    if spec.angle:
        field("angle", spec.angle, "of the description's numbers")
    if isinstance(spec, ArmSpec):
        if spec.joints:
            field("joints", spec.joints, "the arm's; all others are held at 0")
        if spec.until_body:
            field("until_body", spec.until_body, "the first link that is the end-effector's")
        field("mount_body", spec.mount_body, "the flange's link")
        if spec.mount_pos_m or spec.mount_quat_wxyz:
            lines.extend(_unsure(unsure.get("mount_quat_wxyz")))
            lines.append(f"mount_pos_m: {_flow(spec.mount_pos_m)} # the flange in that link")
            lines.append(f"mount_quat_wxyz: {_flow(spec.mount_quat_wxyz)} # its z points out of the arm")
        lines.extend(_unsure(unsure.get("home")))
        lines.append("home: # at rest above a table in front of it, flange down")
        lines.extend(_joints(spec.home, embodiment))
    else:
        if spec.root_body:
            field("root_body", spec.root_body, "the first link")
        if spec.joints:
            field("joints", spec.joints, "its own; that on which its first link hangs is the arm's")
        lines.extend(_unsure(unsure.get("mount_quat_wxyz")))
        lines.append(
            f"mount_pos_m: {_flow(spec.mount_pos_m)} # the first link on the flange, whose z points out of the arm:"
        )
        lines.append(
            f"mount_quat_wxyz: {_flow(spec.mount_quat_wxyz)} # z where the fingers point, y from finger to finger"
        )
        if spec.couplings:
            lines.extend(_unsure(unsure.get("couplings")))
            lines.append("couplings: # q_follower = scale * q_joint + offset")
            for follower, c in spec.couplings.items():
                lines.append(f"  {_flow(follower)}: {_flow({'joint': c.joint, 'scale': c.scale, 'offset': c.offset})}")
        lines.extend(_poses(spec, embodiment, unsure))
        lines.append("pads: # what touches objects, each by default where its link leads as the hand closes")
        lines.extend(f"  - {_flow(_pad(pad))}" for pad in spec.pads)
    lines.extend(_speeds(embodiment))
    servo = spec.servo
    lines.append(
        "# How a simulation drives it, if this does not suit: gains follow from inertia, limits from `effort` if it is given."
    )
    lines.append(
        f"# servo: {{frequency_rad_s: {servo.frequency_rad_s:g}, damping_ratio: {servo.damping_ratio:g}, torque_n_m: {servo.torque_n_m:g}, force_n: {servo.force_n:g}}}"
    )
    return "\n".join(lines) + "\n"


def _unsure(why: str | None) -> list[str]:
    return [f"# UNSURE: {line}" if i == 0 else f"#   {line}" for i, line in enumerate(wrap(why or "", _WIDTH))]


def _flow(value: object) -> str:
    """YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000, sort_keys=False, allow_unicode=True)
    return text.removesuffix("...\n").strip()


def _joints(pose: Mapping[str, float], embodiment: Embodiment) -> list[str]:
    lines = []
    for joint, value in pose.items():
        q = embodiment.joint_names.index(joint)
        room = f"{embodiment.lower[q]:.3g} to {embodiment.upper[q]:.3g} {embodiment.joint_units[q]}"
        lines.append(f"  {_flow(joint)}: {_flow(value)} # {room}")
    return lines


def _poses(spec: EndEffectorSpec, embodiment: Embodiment, unsure: Mapping[str, str]) -> list[str]:
    lines = _unsure(unsure.get("home"))
    if spec.home:
        lines.append("home: # open; a joint that is not listed is at 0; a finger without a pad stays curled")
        lines.extend(_joints(spec.home, embodiment))
    lines.extend(_unsure(unsure.get("closed")))
    lines.append("closed: # those that differ")
    return [*lines, *_joints(spec.closed, embodiment)]


def _pad(pad: Pad) -> dict[str, object]:
    fields: dict[str, object] = {"body": pad.body}
    if pad.geoms:
        fields["geoms"] = pad.geoms
    if pad.share != 1:
        fields["share"] = pad.share
    if tuple(pad.extent) != (0, 1):
        fields["extent"] = pad.extent
    if pad.palmar != "auto":
        fields["palmar"] = pad.palmar
    if pad.palmar_cosine != Pad("").palmar_cosine:
        fields["palmar_cosine"] = pad.palmar_cosine
    return fields


def _speeds(embodiment: Embodiment) -> list[str]:
    """Which joints have a default speed, since nothing gives theirs."""
    defaults = {"rad": DEFAULT_MAX_VELOCITY_RAD_S, "m": DEFAULT_MAX_VELOCITY_M_S}
    rows = zip(embodiment.joint_names, embodiment.joint_units, embodiment.max_velocity, strict=True)
    silent: Sequence[tuple[str, str]] = [(name, unit) for name, unit, speed in rows if speed == defaults[unit]]
    if not silent:
        return []
    lines = [
        "# The description gives no speeds of these; what is assumed may be more than the robot can:",
        "# max_velocity:",
    ]
    return [*lines, *(f"#   {_flow(name)}: {defaults[unit]:g} # {unit}/s" for name, unit in silent)]
