"""`cei-inspect`: each thing that can be wrong with columns is found, by episode, frame and column, and a map is proposed only where it is
well founded."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import older
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from cei_converters.dataset.schema import joint_feature_names
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.inspection.command import main as inspect
from cei_gym.demonstration import Camera, Demonstration, Scene
from cei_gym.embodiment import catalogue, load_embodiment

ROBOT = "Panda-PandaGripper"
BODY = load_embodiment(ROBOT)
SHARED = Path(__file__).parents[2] / "shared"
G1, SO101, LIFT = (
    SHARED / "datasets/g1_inspire_pick_v2.1",
    SHARED / "datasets/so101_pick_v3.0",
    SHARED / "cases/datasets/robosuite_lift_2.hdf5",
)


def motion(frames: int = 60, seed: int = 0) -> np.ndarray:
    """(T, 9) smooth motion within the limits, and slow."""
    random, t = np.random.default_rng(seed), np.linspace(0, 3, frames)[:, None]
    middle, half = (BODY.lower + BODY.upper) / 2, (BODY.upper - BODY.lower) / 2
    q = middle + 0.4 * half * np.sin(t * random.uniform(0.5, 1.0, 9) + random.uniform(0, 6, 9))
    q[:, 7] = 0.02 + 0.018 * np.sin(t[:, 0])
    return BODY.coupled.expand(BODY.coupled.reduce(q))


Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(*states: np.ndarray, names: object = None, ours: bool = False, action: np.ndarray | None = None) -> Path:
        """A dataset of these states, with a lab's names, or with our own and our metadata."""
        root = tmp_path / f"lab{len(list(tmp_path.iterdir()))}"
        scene = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))
        with DatasetWriter("me/lab", root) as writer:
            for state in states:
                writer.add(Demonstration(ROBOT, 20.0, state, state if action is None else action, scene))
        if not ours:
            (root / "meta/cei.json").unlink()
            older.forget(root)
            info = json.loads((root / "meta/info.json").read_text())
            for key in ("observation.state", "action"):
                info["features"][key]["names"] = names or [f"servo_{i}" for i in range(9)]
            (root / "meta/info.json").write_text(json.dumps(info))
        return root

    return write


def said(capsys: pytest.CaptureFixture, root: Path, *options: str) -> str:
    capsys.readouterr()
    assert inspect(["--dataset.repo_id=me/lab", f"--dataset.root={root}", *options]) == 0
    return " ".join(capsys.readouterr().out.split())


def said_without_map(capsys: pytest.CaptureFixture, root: Path, file: Path, source: str = ROBOT) -> str:
    """What is said where a joint map is to be saved, and none can be: all the same, and at the end that, and why."""
    capsys.readouterr()
    args = ["--dataset.repo_id=me/lab", f"--dataset.root={root}", f"--source={source}", f"--save_map={file}"]
    assert inspect(args) == 1
    assert not file.exists()
    printed = capsys.readouterr()
    text, error = " ".join(printed.out.split()), printed.err.splitlines()[-1]
    why = error.removeprefix(f"error: no joint map could be proposed, so {file} is not made: ")
    assert why != error and why in text and "Proposed" not in text
    return text


def column(root: Path, key: str, edit: Callable[[np.ndarray], np.ndarray]) -> None:
    """Other values in a column of the data."""
    path = next(root.glob("data/*/*.parquet"))
    table = pq.read_table(path)
    place, old = table.column_names.index(key), table[key]
    values = edit(np.array(old.to_pylist()))
    pq.write_table(table.set_column(place, table.schema.field(place), pa.array(values.tolist(), old.type)), path)


# frames


def spoilt(frame: int, value: object, joint: int | slice = slice(None)) -> np.ndarray:
    state = motion()
    state[frame, joint] = value
    return state


def turned(joint: int, frame: int) -> np.ndarray:
    state = motion()
    state[frame:, joint] += 2 * np.pi
    return state


def again(frame: int) -> np.ndarray:
    state = motion()
    state[frame] = state[frame - 1]
    return state


FRAMES = {
    "a whole turn": (turned(2, 33), "episode 1, frame 33: servo_2 jumps by 6.3"),
    "a frame of zeros": (spoilt(20, 0.0), "episode 1, frame 20: all columns that move are 0 there, with servo_0 at"),
    "zeros in one column": (spoilt(41, 0.0, 3), "episode 1, frame 41: servo_3 is 0 there, with servo_3 at"),
    "three frames of zeros": (
        spoilt(slice(20, 23), 0.0),
        "frame 20: all columns that move are 0 there and in the next 2",
    ),
    "a frame again": (
        again(30),
        "episode 1, frame 30: it is frame 29 over again, while the robot moves (1 such frames)",
    ),
    "frames in any order": (
        np.random.default_rng(1).permutation(motion()),
        "episode 1: from each frame to the next columns change by",
    ),
    "not finite": (motion(), "Nothing is wrong"),
}


@pytest.mark.parametrize("name", FRAMES)
def test_frames_are_found(name: str, write: Write, capsys: pytest.CaptureFixture) -> None:
    state, message = FRAMES[name]
    text = said(capsys, write(motion(seed=1), state))
    if message != "Nothing is wrong":
        assert message in text, text
        assert "episode 0" not in text
    else:  # of motion nothing is said
        assert "episode" not in text.partition("- ")[2]


def test_time_and_numbers_are_found(write: Write, capsys: pytest.CaptureFixture) -> None:
    def swapped(values: np.ndarray) -> np.ndarray:
        values[[70, 71]] = values[[71, 70]]
        return values

    def same(values: np.ndarray) -> np.ndarray:
        values[75] = values[74]
        return values

    def ahead(values: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(values)) > 80, values + 5, values)

    for name, change, message in (
        ("timestamp", swapped, "11: its time stamp is 0.05 s before the last one's; frames are not in their order"),
        ("timestamp", same, "15: its time stamp is the last one's (1 frames are repeated)"),
        ("frame_index", swapped, "11: frame_index goes back from 11 to 10; frames are not in their order"),
        ("frame_index", same, "15: frame_index is 14 again (1 frames are repeated)"),
        ("frame_index", ahead, "21: frame_index leaps from 20 to 26; frames are missing"),
    ):
        root = write(motion(seed=1), motion())
        column(root, name, change)
        assert f"episode 1, frame {message}" in said(capsys, root)


# joints


def test_limits_and_speeds_are_checked_without_a_map(write: Write, capsys: pytest.CaptureFixture) -> None:
    text = said(capsys, write(motion(), ours=True))
    assert "cei-convert takes them as they are, without a joint map. Nothing is wrong." in text
    fast, out = motion(), motion()
    fast[30:, 1] += 0.5
    out[:, 3] = np.linspace(-0.5, 0.5, 60)
    text = said(capsys, write(motion(seed=1), fast, ours=True))
    assert "joint2 moves at" in text and "rad/s in episode 1, frame 30, and can do 2.17" in text
    text = said(capsys, write(motion(seed=1), out, ours=True))
    assert "joint4 is outside its limits [-3.072, -0.0698] rad in 25.8 % of the frames" in text
    assert "first in episode 1, frame" in text


def test_the_distance_of_two_fingers_is_no_finger(write: Write, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    wide = motion()
    wide[:, 7:] = 2 * np.linspace(0, 0.04, 60)[:, None] * [1, -1]
    text = said(capsys, write(wide, names=joint_feature_names(BODY)), f"--source={ROBOT}")
    assert (
        "joint finger_joint1: observation.state is 0.06" in text and "it looks like the distance of two fingers" in text
    )
    names = [f"joint{i + 1}" for i in range(7)] + ["gripper", "spare"]
    text = said_without_map(capsys, write(wide, names=names), tmp_path / "none.yaml")
    assert "about twice the 0.04 m of finger_joint1: the distance of two fingers?" in text


def test_robosuites_columns_need_no_map(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    import h5py

    path = tmp_path / "lift.hdf5"
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_kwargs": {"control_freq": 20, "robots": "Panda"}})
        data["demo_0/obs/robot0_joint_pos"], data["demo_0/obs/robot0_gripper_qpos"] = motion()[:, :7], motion()[:, 7:]
        closes = np.append(np.diff(motion()[:, 7]), 0) < 0
        data["demo_0/actions"] = np.column_stack([np.zeros((60, 6)), np.where(closes, 1.0, -1.0)])
    text = said(capsys, path, f"--source={ROBOT}")
    assert "cei-convert takes them as they are, without a joint map. Nothing is wrong." in text


def test_nothing_is_advised_that_the_map_says_otherwise(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    state = np.column_stack([np.degrees(motion()[:, :7]), motion()[:, 7], np.full(60, 3.0)])
    root, path = write(state), tmp_path / "map.yaml"
    assert "look like degrees" in said(capsys, root) and "never changes: servo_8" in said(capsys, root)
    groups = [
        {"joints": "arm", "columns": {"start": 0, "end": 7}, "unit": "deg"},
        {"joints": ["finger_joint1"], "columns": ["servo_7"]},
    ]
    path.write_text(yaml.safe_dump({"embodiment": ROBOT, "joints": groups, "ignore": ["servo_8"]}))
    assert said(capsys, root, f"--joint_map={path}").endswith("Nothing is wrong.")
    groups[0]["unit"] = "rad"
    path.write_text(yaml.safe_dump({"embodiment": ROBOT, "joints": groups, "ignore": ["servo_8"]}))
    assert "far outside [-2.897, 2.897] rad; it looks like" in said(capsys, root, f"--joint_map={path}")


# proposals


def test_a_hundred_may_be_degrees_or_normalised(write: Write, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    middle, half = (BODY.lower + BODY.upper) / 2, (BODY.upper - BODY.lower) / 2
    hundred = 100 * (motion() - middle) / half
    hundred[:, 7] = 100 * motion()[:, 7] / 0.04
    names = [f"joint{i + 1}.pos" for i in range(7)] + ["gripper.pos", "spare.pos"]
    hundred[:, 8] = 0.0
    text = said_without_map(capsys, write(hundred, names=names), tmp_path / "map.yaml")
    assert "joint1.pos" in text and "are degrees, or LeRobot's normalised -100 to 100" in text
    assert "gripper.pos: look like a gripper's 0 to 100" in text
    assert "look like degrees" not in text


def test_what_fits_in_two_places_is_not_proposed(write: Write, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    state = motion()
    state[:, 8] = state[:, 7]  # two columns that may be the finger
    text = said_without_map(capsys, write(state), tmp_path / "map.yaml")
    assert "may be columns servo_7, servo_8: all are within its limits, and names say nothing" in text
    assert "of it, arm is columns 0 to 6" in text


@pytest.mark.parametrize("before", ["", "panda_"])
def test_a_name_that_another_ends_with_is_its_own(
    before: str, write: Write, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """finger_joint1 ends with joint1, and is not it."""
    names = [f"{before}{name}" for name in joint_feature_names(BODY)]
    assert f"{before}joint1.pos_rad" in names and f"{before}finger_joint1.pos_m" in names
    order = np.roll(np.arange(9), 2)  # fingers first
    path = tmp_path / "map.yaml"
    said(capsys, write(motion()[:, order], names=[names[i] for i in order]), f"--source={ROBOT}", f"--save_map={path}")
    arm, finger = yaml.safe_load(path.read_text())["joints"]
    assert (arm["joints"], arm["columns"]) == ("arm", {"start": 2, "end": 9})
    assert (finger["joints"], finger["columns"]) == ("end_effector", {"start": 0, "end": 1})


NESTED = [
    [
        *(f"kLeft{part}" for part in ("Shoulder", "Elbow", "Wrist")),
        *(f"kRight{part}" for part in ("Shoulder", "Elbow", "Wrist")),
        *("kLeftGripper", "kRightGripper", "kWaist"),
    ]
]


def test_sides_in_names_must_agree(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """A right arm of three joints is not told to be the left one, which fits as well."""
    joints = "".join(
        f'<body name="b{i}" pos="0 0 .2"><joint name="right_{name}_joint" range="-2 2"/><geom size=".02"/>'
        for i, name in enumerate(("shoulder", "elbow", "wrist"))
    )
    (tmp_path / "arms").mkdir()
    (tmp_path / "end_effectors").mkdir()
    (tmp_path / "arms/arm.xml").write_text(
        f"<mujoco><compiler angle='radian'/><worldbody><body name='base'><geom size='.05'/>{joints}{'</body>' * 3}</body></worldbody></mujoco>"
    )
    spec = {"name": "RightArm", "description": "arm.xml", "mount_body": "b2", "home": {}}
    (tmp_path / "arms/RightArm.yaml").write_text(yaml.safe_dump(spec))
    monkeypatch.setenv(catalogue.FOLDERS, str(tmp_path))
    state = 0.3 * np.sin(np.linspace(0, 3, 60)[:, None] * np.linspace(0.5, 1.5, 9))
    state[:, 6:8] = 0.02 + 0.018 * np.sin(np.linspace(0, 3, 60))[:, None]
    root, path = write(state, names=NESTED), tmp_path / "map.yaml"
    text = said(capsys, root, "--source=RightArm-PandaGripper", f"--save_map={path}")
    raw = yaml.safe_load(path.read_text())
    assert raw["joints"][0]["columns"] == {"start": 3, "end": 6}, text
    assert raw["joints"][1]["columns"] == {"start": 7, "end": 8}, text
    raw["joints"][0]["columns"] = {"start": 0, "end": 3}
    path.write_text(yaml.safe_dump(raw))
    text = said(capsys, root, f"--joint_map={path}")
    assert (
        "columns of one side are mapped to joints of the other: kLeftShoulder to right_shoulder_joint, kLeftElbow"
        in text
    )


@pytest.mark.skipif(not SO101.exists(), reason="needs ../shared/datasets")
def test_a_real_so101_is_not_called_degrees(capsys: pytest.CaptureFixture) -> None:
    text = said(capsys, SO101)
    assert (
        "shoulder_pan.pos, shoulder_lift.pos, elbow_flex.pos, wrist_flex.pos, wrist_roll.pos: are degrees, or LeRobot's"
        in text
    )
    assert "gripper.pos: look like a gripper's 0 to 100" in text and "look like degrees" not in text


@pytest.mark.skipif(not G1.exists(), reason="needs ../shared/datasets")
def test_a_real_g1s_right_arm_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "home"))
    joints = [
        f"right_{part}_joint"
        for part in [
            "shoulder_pitch",
            "shoulder_roll",
            "shoulder_yaw",
            "elbow",
            "wrist_roll",
            "wrist_pitch",
            "wrist_yaw",
        ]
    ]
    for folder in ("arms", "end_effectors"):
        (tmp_path / folder).mkdir()
    spec = {
        "name": "G1Right",
        "description": str((SHARED / "robots/unitree_g1/g1_body29_hand14.urdf").resolve()),
        "root_body": "torso_link",
        "joints": joints,
        "mount_body": "right_wrist_yaw_link",
        "home": {"right_elbow_joint": 0.5},
    }
    (tmp_path / "arms/G1Right.yaml").write_text(yaml.safe_dump(spec))
    monkeypatch.setenv(catalogue.FOLDERS, str(tmp_path))
    text = said_without_map(capsys, G1, tmp_path / "map.yaml", "G1Right-Inspire")
    assert "of it, arm is columns 7 to 13 by its names or limits" in text
    assert "may be kRightHandPinky, kRightHandRing" in text
    cases = SHARED / "cases/datasets/nested_names"
    assert "mapped to joints of the other" not in said(capsys, G1, f"--joint_map={cases / 'map.yaml'}")
    text = said(capsys, G1, f"--joint_map={cases / 'guess.yaml'}")
    assert (
        "columns of one side are mapped to joints of the other: kLeftShoulderPitch to right_shoulder_pitch_joint"
        in text
    )


@pytest.mark.skipif(not LIFT.exists(), reason="needs ../shared/cases")
def test_a_robosuite_file_is_not_called_the_wrong_robot(capsys: pytest.CaptureFixture) -> None:
    text = said(capsys, LIFT, f"--source={ROBOT}")
    assert "without a joint map. Nothing is wrong." in text


def test_joints_are_mapped_though_cameras_are_not_calibrated(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    root, state = tmp_path / "lab", motion()
    camera = Camera("front", 8, 6, np.array([[8.0, 0, 4], [0, 8.0, 3], [0, 0, 1]]), np.eye(4))
    scene = Scene(np.eye(4), (camera,), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))
    with DatasetWriter("me/lab", root) as writer:
        depth_m = {"front": np.ones((len(state), 6, 8), np.float32)}
        writer.add(Demonstration(ROBOT, 20.0, state, state, scene, depth_m=depth_m))
    (root / "meta/cei.json").unlink()
    older.forget(root)
    info = json.loads((root / "meta/info.json").read_text())
    for key in ("observation.state", "action"):
        info["features"][key]["names"] = [f"panda_{name}" for name in BODY.joint_names]
    (root / "meta/info.json").write_text(json.dumps(info))
    file = tmp_path / "map.yaml"
    text = said(capsys, root, f"--source={ROBOT}", f"--save_map={file}")
    assert "Proposed joint map" in text and "calibration" not in text
    assert yaml.safe_load(file.read_text())["embodiment"] == ROBOT
