"""Actions of robosuite's environments: which entries are the gripper's, and what they tell it.

robosuite concatenates what its controllers take: the arm's, then the gripper's. A recorded file says which controllers in its
`env_args`, or that there were the robot's own; nothing says the entries' places, so they are derived and checked against how
many there are.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from cei_converters.sources.binding import ARM, END_EFFECTOR, independent_joints, n_arm
from cei_converters.sources.joint_map import ABSOLUTE, NEXT_STATE, OPEN_CLOSE, ActionGroup, ActionMap
from cei_gym.embodiment import Embodiment
from cei_gym.errors import CEIError

ACTIONS = "actions"
_DEFAULT = "OSC_POSE"  # of all robots with one arm that robosuite has
_OF_POSES = {"OSC_POSE": 6, "OSC_POSITION": 3, "IK_POSE": 6}
_GAINS = {"fixed": 0, "variable": 2, "variable_kp": 1}  # so many more times: damping and stiffness
_OF_JOINTS = ("JOINT_POSITION", "JOINT_VELOCITY", "JOINT_TORQUE")
# hands whose entries are positions, from -1 to 1 over each motor's range; of all others, an entry's sign says to open or to close
_POSITIONED = ("InspireLeftHand", "InspireRightHand", "FourierLeftHand", "FourierRightHand")


def action_entries(kwargs: Mapping[str, Any], embodiment: Embodiment, width: int, where: str) -> ActionMap:
    """What the entries of an action are.

    Args:
        kwargs: `env_kwargs` of the file's `env_args`.
        embodiment: the robot.
        width: how many entries there are.
        where: the file, for messages.

    Raises:
        CEIError: it does not add up, with the numbers and what a joint map would say.
    """
    arm, controller, absolute = _arm_entries(kwargs, embodiment, where, width)
    rest, fingers = width - arm, _motors(embodiment)
    gripper = _gripper(kwargs, embodiment)
    groups = [
        ActionGroup(ARM, [str(i) for i in range(arm)], kind=ABSOLUTE) if absolute else ActionGroup(ARM, kind=NEXT_STATE)
    ]
    columns = [str(i) for i in range(arm, width)]
    if not fingers and rest == 0:
        pass
    elif fingers and rest == 1:
        groups.append(ActionGroup(END_EFFECTOR, columns, kind=OPEN_CLOSE))
    elif fingers and rest == len(fingers):
        groups += _each(fingers, columns, gripper in _POSITIONED, embodiment)
    else:
        raise _does_not_add_up(
            where,
            width,
            f"{controller} takes {arm}, which leaves {rest} for the gripper {gripper}, where {_expected(fingers)}",
        )
    return ActionMap(ACTIONS, ABSOLUTE, groups, "rest")


def _arm_entries(kwargs: Mapping[str, Any], embodiment: Embodiment, where: str, width: int) -> tuple[int, str, bool]:
    """How many entries the arm takes, by which controller, and whether they are its joints' targets."""
    robots = kwargs.get("robots")
    if isinstance(robots, list) and len(robots) > 1:
        raise _does_not_add_up(where, width, f"they are those of {len(robots)} robots")
    parts = list(_arm_parts(kwargs.get("controller_configs")))
    if len(parts) > 1:
        raise _does_not_add_up(where, width, f"they are those of {len(parts)} arms")
    part = parts[0] if parts else {}
    name, gains = part.get("type", _DEFAULT), part.get("impedance_mode", "fixed")
    if gains not in _GAINS or not isinstance(name, str):
        raise _does_not_add_up(where, width, f"the controller {name!r} with impedance_mode {gains!r} is unknown")
    if name in _OF_POSES:
        own = _OF_POSES[name]
        return own + 6 * _GAINS[gains] * (name != "IK_POSE"), name, False
    if name in _OF_JOINTS:
        absolute = name == "JOINT_POSITION" and part.get("input_type") == "absolute"
        return embodiment.n_arm * (1 + (name == "JOINT_POSITION") * _GAINS[gains]), name, absolute
    raise _does_not_add_up(where, width, f"how many the controller {name!r} takes is not known here")


def _arm_parts(configs: Any) -> Iterator[Mapping[str, Any]]:
    """Controllers of arms, of any of robosuite's layouts: one flat mapping, in a list, or in body_parts, there maybe in arms."""
    if isinstance(configs, list):
        for each in configs:
            yield from _arm_parts(each)
    if not isinstance(configs, Mapping):
        return
    parts = configs.get("body_parts")
    if not isinstance(parts, Mapping):
        if "type" in configs and configs["type"] != "BASIC":
            yield configs
        return
    arms = parts.get("arms", parts)
    sides = {
        side: arms[side]
        for side in ("right", "left")
        if isinstance(arms, Mapping) and isinstance(arms.get(side), Mapping)
    }
    yield from (
        [sides["right"]] if "right" in sides else sides.values()
    )  # robosuite's robots with one arm have a right one


def _gripper(kwargs: Mapping[str, Any], embodiment: Embodiment) -> str:
    """Its name in robosuite."""
    said = kwargs.get("gripper_types")
    said = said[0] if isinstance(said, list) and len(said) == 1 else said
    if isinstance(said, str) and said != "default":
        return said
    hand = embodiment.end_effector
    return "" if hand is None else hand.simulator_name or hand.name


def _motors(embodiment: Embodiment) -> list[tuple[str, list[float]]]:
    """Give for each of the end-effector's independent joints its name and what its motor can be told, in the order of the motors."""
    independent = independent_joints(embodiment)
    order: dict[str, list[float]] = {}
    for q, *told in embodiment.motors:
        if q < embodiment.n_arm:
            continue
        leader = independent[embodiment.coupled.leader[q]]
        order.setdefault(leader, [])
        if embodiment.joint_names[q] == leader:
            order[leader] = told
    hand = independent[n_arm(embodiment) :]
    return list(order.items()) if sorted(order) == sorted(hand) else [(joint, []) for joint in hand]


def _each(
    motors: list[tuple[str, list[float]]], columns: list[str], positioned: bool, embodiment: Embodiment
) -> list[ActionGroup]:
    """A group for each joint with an entry of its own."""
    groups = []
    for (joint, limits), column in zip(motors, columns, strict=True):
        q = embodiment.joint_names.index(joint)
        if positioned and limits:
            groups.append(ActionGroup([joint], [column], "normalised", range=[-1.0, 1.0], limits=limits, kind=ABSOLUTE))
        elif embodiment.home[q] != embodiment.closed[q]:
            groups.append(ActionGroup([joint], [column], kind=OPEN_CLOSE))
        else:
            groups.append(ActionGroup([joint], kind=NEXT_STATE))
    return groups


def _expected(motors: list[tuple[str, list[float]]]) -> str:
    if not motors:
        return "there is none"
    one = "it takes 1, to open and close"
    return (
        one if len(motors) == 1 else f"{one}, or {len(motors)}, one each of {', '.join(joint for joint, _ in motors)}"
    )


def _does_not_add_up(where: str, width: int, why: str) -> CEIError:
    """What is wrong, and a joint map's lines that would be right."""
    groups = [
        {"joints": ARM, "kind": NEXT_STATE},
        {"joints": END_EFFECTOR, "columns": [str(width - 1)], "kind": OPEN_CLOSE},
    ]
    said = yaml.safe_dump(
        {"feature": ACTIONS, "ignore": "rest", "joints": groups}, default_flow_style=True, width=1000
    ).strip()
    return CEIError(
        f"{where}: {ACTIONS} has {width} entries, but {why}. A joint map (--joint_map) says which are the gripper's, such as "
        f"action: {said}, or action: null, without the gripper's command."
    )
