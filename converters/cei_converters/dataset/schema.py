"""Names, shapes and units of the features of our LeRobot v3.0 datasets."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from cei_gym.channels import Channel, channels, entry_names, present
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError, one_line

STATE = "observation.state"
ACTION = "action"
# a key that contains "image" trips LeRobot's check of image statistics
POINT_CLOUD = "observation.point_cloud"
PRIVILEGED_STATE = "privileged.environment_state"
"""What a simulator knows of its objects, where no policy looks: LeRobot's take what begins with `observation`."""
ENVIRONMENT_STATE = "observation.environment_state"
"""The same where LeRobot's policies take it by themselves: in datasets of format 1.0 and 1.1, and where it is asked for."""
STATES_OF_OBJECTS = (PRIVILEGED_STATE, ENVIRONMENT_STATE)
DEPTH_PREFIX = "observation.depth."
RGB_PREFIX = "observation.images."
SEGMENTATION_PREFIX = "observation.segmentation."
"""Pictures, named after depth cameras and as large, that are bright where objects are."""

UNITS = ("rad", "m")


def state_key(privileged: bool) -> str:
    """Where the state of objects goes: with `privileged`, to where LeRobot's policies take it."""
    return ENVIRONMENT_STATE if privileged else PRIVILEGED_STATE


def joint_feature_name(joint: str, unit: str) -> str:
    """`joint_1`, `rad` -> `joint_1.pos_rad`."""
    return f"{joint}.pos_{unit}"


def joint_feature_names(embodiment: Embodiment) -> list[str]:
    """Feature names of an embodiment's joints, arm then end-effector."""
    pairs = zip(embodiment.joint_names, embodiment.joint_units, strict=True)
    return [joint_feature_name(joint, unit) for joint, unit in pairs]


def parse_joint_feature_name(name: str) -> tuple[str, str]:
    """`joint_1.pos_rad` -> (`joint_1`, `rad`).

    Raises:
        CEIError: the name has no unit, or one that is not rad or m.
    """
    joint, _, unit = name.rpartition(".pos_")
    if not joint:
        right = " or ".join(repr(joint_feature_name(name.removesuffix(".pos"), unit)) for unit in UNITS)
        raise CEIError(f"{name}: the joint's name carries no unit; it should read {right}.")
    if unit in ("deg", "degree", "degrees"):
        raise CEIError(f"{name}: degrees are not supported, convert to rad.")
    if unit not in UNITS:
        raise CEIError(f"{name}: unit {unit!r} is not supported. Valid: {', '.join(UNITS)}.")
    return joint, unit


def check_joint_names(names: Sequence[str], embodiment: Embodiment, where: str) -> None:
    """Check that names are the embodiment's joints, in its order and units.

    Raises:
        CEIError: saying which name differs first and what would be right.
    """
    for name in names:
        try:
            parse_joint_feature_name(name)
        except CEIError as error:
            raise CEIError(f"{where}: {error}") from error
    expected = joint_feature_names(embodiment)
    if len(names) != len(expected):
        raise CEIError(
            f"{where} has {len(names)} joints but {embodiment.name} has {len(expected)}: {', '.join(expected)}."
        )
    for position, (name, right) in enumerate(zip(names, expected, strict=True)):
        if name != right:
            raise CEIError(
                f"{where}: joint {position} is {name!r} but {embodiment.name} has {right!r} there; "
                f"its order is {', '.join(expected)}."
            )


def feature_names(feature: Mapping[str, object]) -> list[str]:
    """Names of a feature's entries, in whatever form they are.

    LeRobot has them as a list; others as a list in a list, as groups of lists, as name to place, or leave some out, for which
    their place stands. A group's name goes before names that several groups have.
    """
    names = _flat(feature.get("names"), "", _DEEPEST)
    plain = [name for _, name in names]
    if not any(plain):
        return []
    if len(set(plain)) < len(plain):
        plain = [f"{group}.{name}" if group and name else name for group, name in names]
    return [name or str(place) for place, name in enumerate(plain)]


def words(name: str) -> list[str]:
    """A name in lower case, cut where its kind of letters changes."""
    return re.findall(r"[a-z]+|[0-9]+", re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", name).lower())


_DEEPEST = 8


def _flat(names: object, group: str, deeper: int) -> list[tuple[str, str]]:
    """Group and name of each; no name where there is none."""
    if names is None:
        return []
    if not isinstance(names, (list, tuple, Mapping)) or not deeper:
        return [(group, "".join(str(names).split("\n"))[:100])]
    if isinstance(names, Mapping):
        places = list(names.values())
        if all(type(place) is int for place in places) and sorted(places) == list(range(len(places))):
            return [(group, str(name)) for name in sorted(names, key=names.__getitem__)]
        if not any(isinstance(item, (list, tuple, Mapping)) for item in places):
            return [(group, str(name)) for name in names]
        pairs = [(f"{group}.{key}" if group else str(key), item) for key, item in names.items()]
        return [found for name, item in pairs for found in _flat(item, name, deeper - 1)]
    return [found for item in names for found in ([(group, "")] if item is None else _flat(item, group, deeper - 1))]


def cloud_feature(points: int, columns: int) -> dict[str, Any]:
    """LeRobot's feature of point clouds: flat, since its tools fail on arrays of two dimensions, and `info` says their layout."""
    names = ["x_m", "y_m", "z_m", *["r", "g", "b"][: columns - 3]]
    layout = {"shape": [points, columns], "columns": names, "frame": "world"}
    return {"dtype": "float32", "shape": (points * columns,), "names": None, "info": layout}


def cloud_shape(feature: Mapping[str, Any], where: str) -> tuple[int, int]:
    """Points and columns (3, or 6 with colours) of a feature of point clouds, flat or, as in formats 1.0 and 1.1, not.

    Raises:
        CEIError: it does not say them.
    """
    shape = layout = [*feature["shape"]]
    if len(shape) == 1:
        layout = (feature.get("info") or {}).get("shape")
    sides = layout if isinstance(layout, list) and all(type(side) is int and side > 0 for side in layout) else []
    if len(sides) != 2 or sides[1] not in (3, 6) or math.prod(sides) != math.prod(shape):
        raise CEIError(
            f"{where} has shape {one_line(shape, 60)}{f' and info.shape {one_line(layout, 60)}' * (len(shape) == 1)}; it should "
            "be [points, 3], or 6 with colours, or flat with that in its info.shape."
        )
    return sides[0], sides[1]


def channel_key(name: str, camera: str = "", state_key: str = PRIVILEGED_STATE) -> str:
    """Feature key of a demonstration's channel.

    Args:
        name: of the channel.
        camera: of a channel that cameras have.
        state_key: where the state of objects goes, `PRIVILEGED_STATE` or `ENVIRONMENT_STATE`.
    """
    own = {"qpos": STATE, "action": ACTION, "point_cloud_world": POINT_CLOUD, "environment_state": state_key}
    by_camera = {"depth_m": DEPTH_PREFIX, "rgb": RGB_PREFIX}
    return by_camera[name] + camera if name in by_camera else own.get(name, f"observation.{name}")


def sensors(features: Mapping[str, Mapping[str, object]]) -> dict[str, str]:
    """Channels of sensors that a dataset has, name to feature key: only where entries are named as they are declared, as the same key may
    mean other units and axes elsewhere."""
    keys = {name: (channel_key(name), declared) for name, declared in channels(Demonstration).items() if declared.names}
    return {
        name: key
        for name, (key, declared) in keys.items()
        if key in features and tuple(feature_names(features[key])) == declared.names
    }


def features(
    embodiment: Embodiment, demonstration: Demonstration, state_key: str = PRIVILEGED_STATE
) -> dict[str, dict[str, Any]]:
    """LeRobot features for demonstrations that carry the same channels as the given one.

    Args:
        embodiment: whose joints they have.
        demonstration: what they carry.
        state_key: where the state of objects goes, `PRIVILEGED_STATE` or `ENVIRONMENT_STATE`.
    """
    names = {"qpos": joint_feature_names(embodiment), "action": joint_feature_names(embodiment)}
    return {
        channel_key(name, camera, state_key): _feature(
            name, declared, array.shape[1:], names.get(name) or list(entry_names(demonstration, name))
        )
        for name, declared, value in present(demonstration)
        for camera, array in declared.arrays(value).items()
    }


def _feature(name: str, declared: Channel, shape: tuple[int, ...], names: list[str]) -> dict[str, Any]:
    """LeRobot's feature of a channel's array, whose frames have this shape."""
    pictures = {"dtype": "image", "names": ["height", "width", "channels"]}  # lossless: colours at edges go with depth
    match name:
        case "point_cloud_world":
            return cloud_feature(*shape)
        case "depth_m":  # LeRobot's depth video rounds to 12 bits
            return {**pictures, "shape": (*shape, 1), "info": {"is_depth_map": True, "depth_unit": "mm"}}
        case "rgb":
            return {**pictures, "shape": shape}
    of_sensor = {"info": {"unit": declared.unit, "frame": declared.frame}} if declared.names else {}
    return {"dtype": declared.dtype, "shape": shape, "names": names or None, **of_sensor}
