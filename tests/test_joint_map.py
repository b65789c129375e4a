"""Joint maps: columns of any name, order, sign and unit become an embodiment's joints; what is wrong is said."""

import json
from collections.abc import Callable
from pathlib import Path

import killed
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from cei_converters.dataset.writer import DatasetWriter
from cei_converters.inspection.command import main as inspect
from cei_converters.sources.binding import bind
from cei_converters.sources.formats import open_source
from cei_converters.sources.joint_map import JointMap, load_joint_map
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError

ROBOT = "Panda-PandaGripper"
BODY = load_embodiment(ROBOT)
INDEPENDENT = [BODY.joint_names[q] for q in BODY.coupled.independent]


@settings(max_examples=50, deadline=None)
@given(st.permutations(range(8)), st.lists(st.sampled_from((1, -1)), min_size=7, max_size=7), st.integers(0, 1000))
def test_what_is_scrambled_comes_back(order: list[int], sign: list[int], seed: int) -> None:
    random = np.random.default_rng(seed)
    lower, upper = BODY.independent_limits
    u = random.uniform(lower, upper, (5, 8))
    offset = random.uniform(-1, 1, 7)
    stored = np.empty((5, 10))
    stored[:, [8, 9]] = 7.0
    stored[:, [order[i] for i in range(7)]] = np.degrees((u[:, :7] - offset) * sign)
    stored[:, order[7]] = 100 - 100 * u[:, 7] / 0.04  # percent closed
    arm = {"joints": "arm", "columns": [str(order[i]) for i in range(7)], "unit": "deg"}
    hand = {"joints": ["finger_joint1"], "columns": [f"c{order[7]}"], "unit": "normalised", "range": [100, 0]}
    names = [f"c{i}" for i in range(10)]
    bound = bind(
        decode({"joints": [arm | {"sign": sign, "offset": offset.tolist()}, hand], "ignore": ["8", "9"]}), BODY, names
    )
    np.testing.assert_allclose(bound.qpos(stored), BODY.coupled.expand(u), atol=1e-9)


def decode(raw: dict) -> JointMap:
    import draccus

    return draccus.decode(JointMap, raw)


ARM = {"joints": "arm", "columns": {"start": 0, "end": 7}}
HAND = {"joints": ["finger_joint1"], "columns": ["7"]}


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        ({"joints": [ARM]}, "Panda-PandaGripper also has finger_joint1; map them, or say where they are in fixed."),
        (
            {"joints": [ARM, HAND]},
            "columns 8 are neither used nor ignored; list them under ignore, or write ignore: rest.",
        ),
        ({"joints": [ARM, HAND], "ignore": ["7", "8"]}, "ignore names 7, which the map uses."),
        ({"joints": [ARM, HAND], "ignore": "all"}, "ignore should be a list of columns or 'rest', not 'all'."),
        ({"joints": [ARM, HAND, ARM]}, "joint joint1 is mapped twice."),
        ({"joints": [ARM, HAND], "fixed": {"joint2": 0.0}}, "joint joint2 is both mapped and fixed."),
        ({"joints": [ARM | {"joints": "legs"}]}, "joints should be a list, arm or end_effector, not 'legs'."),
        (
            {"joints": [ARM | {"joints": ["joint0"]}]},
            "unknown joint of Panda-PandaGripper 'joint0'. Did you mean 'joint7'?",
        ),
        ({"joints": [ARM | {"columns": {"start": 0, "end": 6}}]}, "but 6 columns."),
        (
            {"joints": [ARM | {"columns": {"start": 4, "end": 11}}]},
            "columns 4 to 11: it should be 0 <= start < end <= 9.",
        ),
        ({"joints": [ARM | {"columns": ["gripper"]}]}, "unknown column 'gripper'."),
        ({"joints": [ARM | {"unit": "grad"}]}, "unknown unit 'grad'."),
        ({"joints": [ARM | {"unit": "mm"}]}, "joint1 is in rad; its columns cannot be in mm."),
        ({"joints": [ARM | {"unit": "ticks"}]}, "joint1: ticks need range: [at the lower limit, at the upper limit]."),
        ({"joints": [ARM | {"range": [0, 1]}]}, "joint1: range and limits are for normalised and ticks, not for si."),
        ({"joints": [ARM | {"unit": "ticks", "range": [5, 5]}]}, "range should be two different finite numbers"),
        ({"joints": [ARM | {"sign": 2}]}, "sign of joint1 should be 1 or -1, not 2."),
        ({"joints": [ARM | {"offset": [0.0, 1.0]}]}, "offset should be one number or 7, not [0.0, 1.0]."),
        ({"joints": [ARM, HAND], "fps": -1.0}, "fps should be above 0, not -1."),
        (
            {"joints": [HAND], "pose": {"columns": {"start": 0, "end": 6}, "rotation": "quat_xyzw"}},
            "pose: quat_xyzw needs 7 columns, not 6.",
        ),
        ({"joints": [HAND], "pose": {"columns": ["0"], "rotation": "euler"}}, "pose: unknown rotation 'euler'."),
        (
            {"joints": [ARM, HAND], "pose": {"columns": {"start": 0, "end": 6}, "rotation": "rotvec"}},
            "joint joint1 is mapped, but pose gives all of the arm's; leave one out.",
        ),
    ],
)
def test_what_is_wrong_is_said(raw: dict, message: str) -> None:
    with pytest.raises(CEIError) as error:
        bind(decode(raw), BODY, [str(i) for i in range(9)])
    assert message in str(error.value)
    assert str(error.value).startswith("joint map: ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("joints: 3", "joint_map.yaml: not a valid JointMap"),
        ("- 1", "joint_map.yaml: not a valid JointMap: expected a mapping"),
        ("joints: [{joints: arm, colums: [a]}]", "joint_map.yaml: not a valid JointMap"),
        ("joints: !!python/object:os.system x", "joint_map.yaml: not a valid JointMap"),
        ("\tjoints", "joint_map.yaml: not a valid JointMap"),
    ],
)
def test_a_file_that_is_none_is_named(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "joint_map.yaml"
    path.write_text(text)
    with pytest.raises(CEIError, match=message):
        load_joint_map(path)


@pytest.fixture
def scrambled(tmp_path: Path) -> Callable[[np.ndarray, np.ndarray], Path]:
    """Writes a dataset whose features have a lab's own names and units, as LeRobot's tools make it."""

    def write(state: np.ndarray, action: np.ndarray) -> Path:
        root = tmp_path / "lab"
        scene = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))
        with DatasetWriter("me/lab", root) as writer:
            writer.add(Demonstration(ROBOT, 20.0, state, action, scene))
        (root / "meta/cei.json").unlink()
        info = json.loads((root / "meta/info.json").read_text())
        for key in ("observation.state", "action"):
            info["features"][key] |= {"names": [f"servo_{i}" for i in range(state.shape[1])], "info": {}}
        (root / "meta/info.json").write_text(json.dumps(info))
        return root

    return write


def test_a_dataset_in_degrees_converts_by_its_map(scrambled: Callable, tmp_path: Path) -> None:
    qpos = BODY.home + np.cumsum(np.random.default_rng(0).normal(0, 0.01, (9, 9)), axis=0)
    qpos = BODY.coupled.expand(np.clip(BODY.coupled.reduce(qpos), *BODY.independent_limits))
    stored = np.column_stack([qpos[:, 7] / 0.04, qpos[:, 8], np.degrees(qpos[:, :7])])
    root = scrambled(stored, stored)
    path = tmp_path / "joint_map.yaml"
    arm = {"joints": "arm", "columns": {"start": 2, "end": 9}, "unit": "deg"}
    hand = {"joints": ["finger_joint1"], "columns": ["servo_0"], "unit": "normalised"}
    path.write_text(yaml.safe_dump({"embodiment": ROBOT, "joints": [arm, hand], "ignore": "rest"}))
    read = open_source("me/lab", root, joint_map=path).read(0)
    np.testing.assert_allclose(read.qpos, qpos, atol=2e-6)
    np.testing.assert_allclose(read.action, qpos, atol=2e-6)
    with pytest.raises(CEIError, match="name the robot with --source"):
        open_source("me/lab", root)
    from cei_converters import convert

    options = killed.arguments(root, tmp_path / "out", f"--joint_map={path}")
    assert (
        convert.main([o for o in options if not o.startswith("--dataset.repo_id")] + ["--dataset.repo_id=me/lab"]) == 0
    )
    made = json.loads((tmp_path / "out/meta/cei.json").read_text())
    assert made["provenance"]["source"]["embodiment"] == ROBOT
    assert made["provenance"]["options"]["joint_map"]["joints"][0]["unit"] == "deg"


def test_targets_past_limits_stop_there_and_are_no_wrong_unit(scrambled: Callable, tmp_path: Path) -> None:
    qpos = np.tile(BODY.home, (5, 1))
    pressed = qpos.copy()
    pressed[:, 7] = -0.3  # a command to close
    root, path = scrambled(qpos, pressed), tmp_path / "joint_map.yaml"
    groups = [{"joints": "arm", "columns": {"start": 0, "end": 7}}, {"joints": ["finger_joint1"], "columns": ["7"]}]
    path.write_text(yaml.safe_dump({"embodiment": ROBOT, "joints": groups, "ignore": "rest"}))
    read = open_source("me/lab", root, joint_map=path).read(0)
    assert (read.action[:, 7] == 0).all()
    np.testing.assert_allclose(read.qpos[:, 7], BODY.home[7], atol=1e-7)


def test_inspect_proposes_the_map_and_says_what_is_wrong(
    scrambled: Callable, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    random = np.random.default_rng(1)
    lower, upper = BODY.lower[:7], BODY.upper[:7]
    t = np.linspace(0, 6, 80)[:, None]
    arm = (lower + upper) / 2 + 0.45 * (upper - lower) * np.sin(
        t * random.uniform(0.4, 0.8, 7) + random.uniform(0, 6, 7)
    )
    finger = 0.02 + 0.02 * np.sin(t)
    state = np.column_stack([np.zeros(80), np.degrees(arm), finger])
    action = np.roll(state, -3, axis=0)
    action[-3:] = state[-1]
    root, proposed = scrambled(state, action), tmp_path / "map.yaml"
    args = ["--dataset.repo_id=me/lab", f"--dataset.root={root}", f"--source={ROBOT}"]
    assert inspect([*args, f"--save_map={proposed}", f"--json={tmp_path / 'found.json'}"]) == 0
    said = capsys.readouterr().out
    assert (
        "servo_1, servo_2, servo_3, servo_4, servo_5, servo_6, servo_7: look like degrees; their groups in a joint map need unit: deg."
        in said
    )
    assert "never changes: servo_0; not recorded, or not used." in said
    found = json.loads((tmp_path / "found.json").read_text())
    assert [column["lag"] for column in found["columns"]] == [None] + [3] * 8
    groups = yaml.safe_load(proposed.read_text())["joints"]
    assert groups[0] == {"joints": "arm", "columns": {"start": 1, "end": 8}, "unit": "deg"}
    assert groups[1]["columns"] == {"start": 8, "end": 9}
    read = open_source("me/lab", root, joint_map=proposed).read(0)
    np.testing.assert_allclose(read.qpos[:, :7], arm, atol=1e-5)
    # a sign is wrong: positions leave the limits, which are not symmetric for the elbow
    raw = yaml.safe_load(proposed.read_text())
    raw["joints"][0]["sign"] = [1, 1, 1, -1, 1, 1, 1]
    proposed.write_text(yaml.safe_dump(raw))
    assert inspect([*args[:2], f"--joint_map={proposed}"]) == 0
    assert "joint4 is outside its limits [-3.072, -0.0698] rad in 100 % of the frames" in " ".join(
        capsys.readouterr().out.split()
    )
    assert inspect([*args, f"--save_map={proposed}"]) == 1
    assert "already exists" in capsys.readouterr().err


def test_inspect_finds_gaps_and_velocities(scrambled: Callable, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    state = np.tile(BODY.home, (30, 1)) + 0.3 * np.sin(np.arange(30) / 5)[:, None]
    velocity = np.gradient(state, axis=0)
    root = scrambled(state, velocity)
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = next(root.glob("data/*/*.parquet"))
    table = pq.read_table(path)
    place = table.column_names.index("timestamp")
    late = table["timestamp"].to_numpy().copy()
    late[20:] += 0.5
    pq.write_table(
        table.set_column(place, table.schema.field(place), pa.array(late, table.schema.field(place).type)), path
    )
    assert inspect(["--dataset.repo_id=me/lab", f"--dataset.root={root}"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert (
        "episode 0, frame 20: time stamps and fps disagree: it comes 0.55 s after the last, at 20 frames a second"
        in said
    )
    assert "the state does not follow the action: servo_0" in said
