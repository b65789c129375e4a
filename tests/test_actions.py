"""What actions mean: kinds and columns of a joint map, targets by closed form, and data that contradict what is said of them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.interpolate import CubicSpline

from cei_converters.sources.actions import BoundActions, action_map, bind_actions, of_all_joints
from cei_converters.sources.joint_map import JointMap, decode
from cei_converters.sources.plausible import check_actions
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError

ROBOT = "Panda-PandaGripper"
BODY = load_embodiment(ROBOT)
LOWER, UPPER = BODY.independent_limits
FPS = 20.0


def path_of(frames: int = 80, seed: int = 0) -> np.ndarray:
    """(T, 8) smooth motion of the independent joints: reach, close on something, come back."""
    random, t = np.random.default_rng(seed), np.linspace(0, 1, frames)[:, None]
    middle, half = (LOWER + UPPER) / 2, (UPPER - LOWER) / 2
    knots = random.uniform(-0.7, 0.7, (6, 8))
    u = middle + half * CubicSpline(np.linspace(0, 1, 6), knots, bc_type="clamped")(t[:, 0])
    u = np.clip(u, LOWER, UPPER)
    u[:, 7] = np.interp(t[:, 0], [0, 0.4, 0.45, 1], [0.039, 0.039, 0.02, 0.02])
    return u


def targets_of(u: np.ndarray, lag: int = 2) -> np.ndarray:
    """(T, 8) what a robot was told that does this, some frames late, and that holds something from 0.42 on."""
    told = np.concatenate([u[lag:], np.repeat(u[-1:], lag, axis=0)])
    told[:, 7] = np.where(np.arange(len(u)) > 0.4 * len(u), 0.0, 0.04)
    return told


def bound(raw: dict[str, Any] | None, columns: Sequence[str], state: dict[str, Any] | None = None) -> BoundActions:
    """A joint map's actions, of a state whose columns are s0 to s7."""
    groups = [{"joints": "arm", "columns": {"start": 0, "end": 7}}, {"joints": ["finger_joint1"], "columns": ["s7"]}]
    mapped = decode({"joints": groups, "action": raw} | (state or {}))
    said = action_map(mapped, None)
    assert said is not None
    return bind_actions(said, BODY, columns, mapped, [f"s{i}" for i in range(8)])


ARM = {"joints": "arm", "columns": {"start": 0, "end": 7}}
HAND = {"joints": "end_effector", "columns": ["g"]}
NAMES = [*(f"a{i}" for i in range(7)), "g"]


def test_targets_by_kind() -> None:
    u, a = path_of(), np.random.default_rng(1).uniform(-0.05, 0.05, (80, 8))
    qpos = BODY.coupled.expand(u)
    ahead = np.concatenate([u[1:], u[-1:]])
    for kind, expected in (("absolute", a), ("delta", u + a), ("velocity", u + a / FPS), ("next_state", ahead)):
        group = {"joints": "arm", "kind": kind} | ({} if kind == "next_state" else {"columns": {"start": 0, "end": 7}})
        actions = bound({"feature": "action", "joints": [group, HAND], "ignore": "rest"}, NAMES)
        made = actions.targets(a, qpos, FPS)
        np.testing.assert_allclose(made[:, :7], np.clip(expected[:, :7], LOWER[:7], UPPER[:7]), atol=1e-12)
        np.testing.assert_allclose(made[:, 7], np.clip(a[:, 7], 0, 0.04), atol=1e-12)
        np.testing.assert_allclose(made[:, 8], -made[:, 7], atol=1e-12)  # which follows


def test_units_and_signs_of_differences_have_no_zero() -> None:
    """A normalised difference of 0 is none, wherever 0 is for a position."""
    group = ARM | {"unit": "normalised", "range": [-100, 100], "sign": -1}
    actions = bound({"feature": "action", "kind": "delta", "joints": [group, HAND | {"kind": "absolute"}]}, NAMES)
    u, a = path_of(), np.zeros((80, 8))
    qpos = BODY.coupled.expand(u)
    np.testing.assert_allclose(actions.targets(a, qpos, FPS)[:, :7], u[:, :7])
    a[:, 0] = 1.0
    moved = actions.targets(a, qpos, FPS)[:, 0] - u[:, 0]
    np.testing.assert_allclose(moved, -(UPPER[0] - LOWER[0]) / 200)


def test_a_command_holds_until_another_is_given() -> None:
    command = np.array([0, 0, -1, 0, 1, 0.2, 0, 0, -0.1, 1], float)
    a, u = np.tile(command[:, None], (1, 8)), path_of(10)
    actions = bound({"feature": "action", "joints": [ARM | {"kind": "delta"}, HAND | {"kind": "open_close"}]}, NAMES)
    told = actions.targets(a, BODY.coupled.expand(u), FPS)[:, 7]
    np.testing.assert_allclose(told[2:], [0.04, 0.04, 0, 0, 0, 0, 0.04, 0])
    np.testing.assert_allclose(told[:2], u[1:3, 7])  # nobody has said anything yet
    turned = HAND | {"kind": "open_close", "range": [1, 0]}  # 1 opens, 0 closes
    actions = bound({"feature": "action", "joints": [ARM | {"kind": "delta"}, turned]}, NAMES)
    told = actions.targets(np.where(a > 0, 0.0, 1.0), BODY.coupled.expand(u), FPS)[:, 7]
    np.testing.assert_allclose(told, np.where(command > 0, 0.0, 0.04))


def test_a_leaders_columns_are_its_own() -> None:
    """Other names, order, count and unit than the follower's."""
    u = path_of()
    told, order = targets_of(u), [3, 0, 1, 2, 6, 5, 4]
    names = [f"leader_{chr(97 + i)}" for i in range(9)]
    values = np.full((80, 9), 7.0)
    values[:, [order[j] for j in range(7)]] = np.degrees(-told[:, :7])
    values[:, 8] = 100 * (1 - told[:, 7] / 0.04)
    arm = {"joints": "arm", "columns": [names[c] for c in order], "unit": "deg", "sign": -1}
    grip = {"joints": ["finger_joint1"], "columns": ["leader_i"], "unit": "normalised", "range": [100, 0]}
    actions = bound({"feature": "leader", "joints": [arm, grip], "ignore": ["leader_h"]}, names)
    np.testing.assert_allclose(actions.targets(values, BODY.coupled.expand(u), FPS)[:, :8], told, atol=1e-9)
    check_actions(actions, values, BODY.coupled.expand(u), FPS, "episode 0")


def test_the_states_groups_find_columns_by_name_in_another_order() -> None:
    order = [7, 3, 0, 1, 2, 6, 5, 4]
    told, u = targets_of(path_of()), path_of()
    actions = bound({"feature": "action"}, [f"s{i}" for i in order])
    np.testing.assert_allclose(actions.targets(told[:, order], BODY.coupled.expand(u), FPS)[:, :8], told, atol=1e-12)


def test_a_state_with_more_than_positions_finds_its_actions_by_name() -> None:
    """As LeRobot has it: positions and speeds, of which only positions are told."""
    state = [f"{name}.{what}" for name in (*"abcdefg", "grip") for what in ("pos", "vel")]
    told = [f"{name}.pos" for name in ("grip", *"gfedcba")]
    groups = [
        {"joints": "arm", "columns": [f"{name}.pos" for name in "abcdefg"]},
        {"joints": ["finger_joint1"], "columns": ["grip.pos"]},
    ]
    mapped = decode({"joints": groups, "action": "action", "ignore": "rest"})
    said = action_map(mapped, None)
    assert said is not None
    actions = bind_actions(said, BODY, told, mapped, state)
    assert actions.column.tolist() == [7, 6, 5, 4, 3, 2, 1, 0]
    with pytest.raises(CEIError, match="has 7 columns but the state has 16"):
        bind_actions(said, BODY, [str(i) for i in range(7)], mapped, state)


@pytest.mark.parametrize(
    ("raw", "columns", "message"),
    [
        ({}, NAMES[:7], "has 7 columns but the state has 8; say which are which under action, with joints: of its own"),
        (
            {},
            ["s0", "s1", *NAMES[2:]],
            "shares some columns with the state (s0, s1), and has a2, a3, a4, a5, ... where",
        ),
        ({"kind": "deltas"}, NAMES, "unknown kind 'deltas'. Did you mean 'delta'?"),
        (
            {"joints": [ARM]},
            NAMES,
            "nothing is said of finger_joint1; map them, or write - {joints: [finger_joint1], kind: next_state}",
        ),
        ({"joints": [ARM, HAND, HAND]}, NAMES, "joint finger_joint1 is mapped twice"),
        ({"joints": [ARM, HAND | {"columns": ["x"]}]}, NAMES, "unknown column 'x'"),
        (
            {"joints": [ARM, {"joints": "end_effector", "kind": "next_state"}]},
            NAMES,
            "columns g are neither used nor ignored",
        ),
        ({"joints": [ARM | {"kind": "delta", "offset": 0.1}, HAND]}, NAMES, "offset is for absolute actions"),
        (
            {"joints": [ARM | {"kind": "open_close", "columns": ["g"]}, HAND]},
            NAMES,
            "has the same pose open (home) and closed",
        ),
    ],
)
def test_what_is_wrong_is_said(raw: dict, columns: list[str], message: str) -> None:
    with pytest.raises(CEIError) as error:
        bound({"feature": "action"} | raw, columns)
    assert message in str(error.value)
    assert str(error.value).startswith("joint map: action: ")


def test_a_map_of_poses_takes_the_fingers_command() -> None:
    """Of the arm the next frame's state; of the fingers what they were told, without which nothing squeezes."""
    raw = {
        "joints": [{"joints": ["finger_joint1"], "columns": ["6"]}],
        "pose": {"columns": {"start": 0, "end": 6}, "rotation": "rotvec"},
        "action": "action",
    }
    mapped: JointMap = decode(raw)
    said = action_map(mapped, None)
    assert said is not None
    columns = [str(i) for i in range(7)]
    actions = bind_actions(said, BODY, columns, mapped, columns)
    u, a = path_of(), np.zeros((80, 7))
    made = actions.targets(a, BODY.coupled.expand(u), FPS)
    np.testing.assert_allclose(made[:-1, :7], u[1:, :7])
    assert (made[:, 7] == 0).all()


# what data contradict


def ahead(u: np.ndarray) -> np.ndarray:
    return np.concatenate([u[1:], u[-1:]]) - u


KINDS: dict[str, tuple[str, Callable[[np.ndarray, np.ndarray], np.ndarray]]] = {
    "targets": ("absolute", lambda u, a: a),
    "the state itself": ("absolute", lambda u, a: u),
    "differences to the state": ("delta", lambda u, a: a - u),
    "differences of states": ("delta", lambda u, a: ahead(u)),
    "speeds": ("velocity", lambda u, a: FPS * ahead(u)),
}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("stored", KINDS)
@pytest.mark.parametrize("said", ["absolute", "delta", "velocity"])
def test_a_kind_that_data_contradict_is_refused(stored: str, said: str, seed: int) -> None:
    """What is right passes, what is wrong is refused with the line that would be right."""
    right, make = KINDS[stored]
    u = path_of(seed=seed)
    values = make(u, targets_of(u))
    values[:, 7] = targets_of(u)[:, 7]
    hand = HAND | {"kind": "absolute"}
    actions = bound({"feature": "action", "kind": said, "joints": [ARM, hand]}, NAMES)
    qpos = BODY.coupled.expand(u)
    if said == right:
        check_actions(actions, values, qpos, FPS, "episode 3")
        return
    with pytest.raises(CEIError) as error:
        check_actions(actions, values, qpos, FPS, "episode 3")
    message = str(error.value)
    assert f"episode 3: action is said to be {said}, but is {right}" in message, message
    assert f"action: {{feature: action, kind: {right}}}" in message
    assert "rad from where the arm is a frame later" in message


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda a: np.degrees(a), "unit: deg"),
        (lambda a: 2 * (a - LOWER) / (UPPER - LOWER) - 1, "unit: normalised, range: [-1, 1]"),
        (lambda a: 100 * (a - LOWER) / (UPPER - LOWER), "unit: normalised, range: ["),
        (lambda a: a * np.where(np.arange(8) == 1, -1, 1), "of joint2 it is"),
        (lambda a: a[:, [0, 2, 1, 3, 4, 5, 6, 7]], "its columns are in another order than the state's"),
        (lambda a: np.clip((a - a.mean(0)) / a.std(0), -2, 2), "joint"),
    ],
)
def test_units_signs_and_columns_that_data_contradict_are_refused(
    spoil: Callable[[np.ndarray], np.ndarray], message: str, seed: int
) -> None:
    u = path_of(seed=seed)
    values = targets_of(u)
    values[:, :7] = spoil(values)[:, :7]
    actions = bound({"feature": "action", "joints": [ARM, HAND]}, NAMES)
    if "another order" in message and np.median(np.abs(u[:, 1] - u[:, 2])) < 0.6 * np.ptp(u[:, 1:3], axis=0).max():
        pytest.skip("the two joints are too near each other to tell")
    with pytest.raises(CEIError) as error:
        check_actions(actions, values, BODY.coupled.expand(u), FPS, "episode 0")
    assert message in str(error.value) and "A joint map says" in str(error.value)


def test_a_gripper_that_goes_the_other_way_is_refused() -> None:
    u = path_of()
    closes = np.append(np.diff(u[:, 7]), 0) < 0
    told = np.where(np.cumsum(closes) > 0, 1.0, -1.0)
    told[:30] = -1  # it opens, closes, and opens again
    u[:30, 7] = np.linspace(0.01, 0.039, 30)
    values = np.column_stack([targets_of(u)[:, :7], told])
    good = bound({"feature": "action", "joints": [ARM, HAND | {"kind": "open_close"}]}, NAMES)
    check_actions(good, values, BODY.coupled.expand(u), FPS, "episode 0")
    turned = bound({"feature": "action", "joints": [ARM, HAND | {"kind": "open_close", "range": [1, -1]}]}, NAMES)
    with pytest.raises(CEIError, match=r"the other way than it is told to in 100 % .* range: \[-1, 1\]"):
        check_actions(turned, values, BODY.coupled.expand(u), FPS, "episode 0")
    values[:, 7] = 0.04 * (told < 0)
    check_actions(bound({"feature": "action", "joints": [ARM, HAND]}, NAMES), values, BODY.coupled.expand(u), FPS, "")
    values[:, 7] = 0.04 * (told > 0)
    with pytest.raises(CEIError, match="open and close are exchanged"):
        check_actions(
            bound({"feature": "action", "joints": [ARM, HAND]}, NAMES), values, BODY.coupled.expand(u), FPS, ""
        )


def test_what_says_nothing_passes() -> None:
    actions = of_all_joints(BODY, "action")
    rest = np.tile(BODY.home, (40, 1))
    check_actions(actions, rest, rest, FPS, "")  # at rest where it is told to be
    check_actions(actions, rest[:3] * 0, rest[:3], FPS, "")  # too short to say anything
    jump = BODY.coupled.expand(path_of())
    told = jump.copy()
    told[:10, :7] += 1.0  # a leader that is found only after half a second
    check_actions(actions, told, jump, FPS, "")


@pytest.mark.parametrize("task", ["PickCube", "OpenDrawer", "StackCube"])
def test_our_own_datasets_pass(task: str, tmp_path: Path) -> None:
    from cei_converters.record import main as record
    from cei_converters.sources.formats import open_source

    root = tmp_path / "own"
    args = [f"--env=CEI-{task}-{ROBOT}", "--episodes=3", "--seed=20", "--repo_id=me/own", f"--root={root}"]
    assert record(args) == 0
    source = open_source("me/own", root)
    assert [len(source.read(i, clouds=False)) > 8 for i in range(3)] == [True] * 3


def test_a_dataset_named_after_the_joints_is_checked_too(tmp_path: Path) -> None:
    """And a joint map of nothing but the kind puts it right."""
    from cei_converters.dataset.writer import DatasetWriter
    from cei_converters.sources.formats import open_source
    from cei_gym.demonstration import Demonstration, Scene

    u = path_of()
    qpos, told = BODY.coupled.expand(u), BODY.coupled.expand(targets_of(u))
    stored = told - qpos
    scene = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))
    with DatasetWriter("me/delta", tmp_path / "delta") as writer:
        writer.add(Demonstration(ROBOT, FPS, qpos, stored, scene))
    with pytest.raises(CEIError, match="episode 0: action is said to be absolute, but is delta"):
        open_source("me/delta", tmp_path / "delta").read(0)
    path = tmp_path / "map.yaml"
    path.write_text(yaml.safe_dump({"action": {"kind": "delta"}}))
    read = open_source("me/delta", tmp_path / "delta", joint_map=path).read(0)
    np.testing.assert_allclose(read.action, np.clip(told, BODY.lower, BODY.upper), atol=1e-5)


def test_the_documented_maps_are_maps() -> None:
    from cei_converters.sources.joint_map import FORMAT

    state, actions = FORMAT.split("\n\n")
    mapped = decode(yaml.safe_load(state.split("\n", 1)[1]))
    assert mapped.action == "action" and len(mapped.joints) == 2 and mapped.fixed == {"joint8": 0.5}
    said = decode(yaml.safe_load(actions.split("\n", 1)[1])).action
    assert said is not None and not isinstance(said, str) and said.joints is not None
    assert (said.kind, [group.kind for group in said.joints]) == ("delta", [None, "open_close"])
    actions_of = bind_actions(said, BODY, [*(str(i) for i in range(7)), "grip"])
    assert actions_of.kinds == ("delta",) * 7 + ("open_close",)
