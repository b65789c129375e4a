"""A joint map's file: which columns of a dataset are which joints of an embodiment, in what unit, and what its actions mean."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import draccus

from cei_converters.sources.pose import PoseMap, Span
from cei_gym.errors import CEIError, one_line
from cei_gym.untrusted import load_yaml

FORMAT = """a joint map (of a dataset whose columns are not named after an embodiment's joints):
  embodiment: Panda-PandaGripper  # --source may say it instead
  state: observation.state
  action: action  # a feature with absolute targets in the state's columns; null: the next frame's state; or as below
  fps: 20  # of formats that do not say it
  joints:
    - joints: [joint1, joint2, joint3, joint4, joint5, joint6, joint7]  # or arm, or end_effector: its independent joints
      columns: {start: 0, end: 7}  # or a list of names or numbers
      unit: deg  # or mm, normalised, ticks; default: rad or m, as the joint is
      sign: [1, 1, -1, 1, 1, 1, 1]  # or one for all
      offset: 0.1  # added after all else, rad or m
    - joints: [finger_joint1, finger_joint2]
      columns: [gripper, gripper]
      unit: normalised
      range: [0, 1]  # what is stored where the joint is at its two limits (of ticks: required)
      limits: [0, 0.04]  # these, if not the embodiment's; rad or m
  fixed: {joint8: 0.5}  # joints that are not recorded, rad or m
  ignore: rest  # or a list of columns: so that none is overlooked

actions that are no absolute targets, or in columns of their own (a leader arm's, say), in place of the line `action` above:
  action:
    feature: action  # default: what the format has
    kind: delta  # added to the state of the same frame; or velocity (a second), absolute (the default), next_state, open_close
    ignore: rest  # columns of the feature that are not used
    joints:  # default: the state's; each group as there, and maybe with a kind of its own
      - {joints: arm, columns: {start: 0, end: 7}, unit: deg}
      - {joints: end_effector, columns: [grip], kind: open_close, range: [-1, 1]}  # what is stored where it is told to open, to close"""
ABSOLUTE, DELTA, VELOCITY, NEXT_STATE, OPEN_CLOSE = "absolute", "delta", "velocity", "next_state", "open_close"
KINDS = (ABSOLUTE, DELTA, VELOCITY, NEXT_STATE, OPEN_CLOSE)
OF_THE_FORMAT = "of the format"
"""What `JointMap.action` is where a map does not say: each format has its own."""
SI = "si"


@dataclass(frozen=True)
class JointGroup:
    """Joints that are stored alike; see `FORMAT`."""

    joints: list[str] | str
    columns: Span | list[str] | None = None
    unit: str = SI
    sign: list[float] | float = 1.0
    offset: list[float] | float = 0.0
    range: list[float] | None = None
    limits: list[float] | None = None


@dataclass(frozen=True)
class ActionGroup(JointGroup):
    """Joints whose actions are stored alike; see `FORMAT`."""

    kind: str | None = None


@dataclass(frozen=True)
class ActionMap:
    """What actions are; see `FORMAT`. None is the default: the format's feature, the state's joints."""

    feature: str | None = None
    kind: str = ABSOLUTE
    joints: list[ActionGroup] | None = None
    ignore: list[str] | str = field(default_factory=list)


@dataclass(frozen=True)
class JointMap:
    """What a YAML file says; `cei-convert --help` has its format. Without joints and pose, the state's columns are the embodiment's
    joints (of formats that name them), and only what is said of actions or fps counts.

    Attributes:
        joints: groups of joints that are stored alike: columns, unit, sign, offset.
        embodiment: whose joints they are; None where the command or the dataset says it.
        state: LeRobot's feature that has the joints.
        action: what actions are; None for the next frame's state.
        fps: frames a second, where the recording does not say.
        pose: where the end-effector's pose is, if there is one instead of the arm's joints.
        fixed: joints that are not stored, and where they stand, rad or m.
        ignore: columns that are no joints, or "rest".
    """

    joints: list[JointGroup] = field(default_factory=list[JointGroup])
    embodiment: str | None = None
    state: str = "observation.state"
    action: ActionMap | str | None = OF_THE_FORMAT
    fps: float | None = None
    pose: PoseMap | None = None
    fixed: dict[str, float] = field(default_factory=dict[str, float])
    ignore: list[str] | str = field(default_factory=list)


def load_joint_map(path: str | Path) -> JointMap:
    """Read a joint map; see `FORMAT`.

    Raises:
        CEIError: naming the file and the field.
    """
    path = Path(path)
    try:
        raw = load_yaml(path.read_text())
        if not isinstance(raw, Mapping):
            raise CEIError("expected a mapping of fields")
        _check_values(raw)
        return decode(dict(raw))
    except FileNotFoundError:
        raise CEIError(f"no such file: {path}.") from None
    except Exception as error:  # draccus raises many kinds
        raise CEIError(f"{path.name}: not a valid JointMap: {one_line(error)}") from error


def decode(raw: dict[str, Any]) -> JointMap:
    """A joint map from plain values.

    Raises:
        CEIError, draccus.utils.DraccusException: a field is unknown, missing or of another type.
    """
    action = raw.get("action", OF_THE_FORMAT)
    if isinstance(action, Mapping):  # by itself, so that what is wrong in it is said: anything can be read as a str
        action = draccus.decode(ActionMap, dict(action))
    elif not isinstance(action, str | None):
        raise CEIError(f"`action` should be a feature's name, null or a mapping, not {one_line(action, 60)}")
    return replace(draccus.decode(JointMap, {**raw, "action": None}), action=action)


_MAY_BE_NULL = ("action", "embodiment", "fps", "pose", "range", "limits", "feature", "kind")


def _check_values(raw: Mapping[Any, Any]) -> None:
    """Refuse null where something should be, and yes and no, which pass for 1 and 0."""
    for name, value in _leaves(raw, ""):
        if value is None and name.rpartition(".")[2] not in _MAY_BE_NULL:
            raise CEIError(f"`{name}` is null; leave it out, or give it a value")
        if isinstance(value, bool):
            raise CEIError(f"`{name}` is {str(value).lower()}; nothing here is true or false (text goes in quotes)")


def _leaves(value: object, name: str) -> Iterator[tuple[str, object]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            if not isinstance(key, str | int):
                raise CEIError(f"`{name}` has {one_line(key, 60)} for a name")
            yield from _leaves(item, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        for item in value:
            yield from _leaves(item, name)
    else:
        yield name, value
