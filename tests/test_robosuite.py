"""robosuite's own demonstrations: the gripper's command is found and read, the table too, and what is converted holds in physics."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

from cei_converters import convert
from cei_converters.sources.actions import bind_actions
from cei_converters.sources.calibration import load_calibration
from cei_converters.sources.formats import open_source
from cei_converters.sources.robosuite import action_entries
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.transfer import Transfer

CASES = Path(__file__).parents[2] / "shared/cases/datasets"
LIFT, TABLE = CASES / "robosuite_lift_2.hdf5", CASES / "table_only_calibration.yaml"
ROBOT = "Panda-PandaGripper"
BASE = "-0.56,0,0.912"
shared = pytest.mark.skipif(not LIFT.exists(), reason="needs ../shared/cases")


def osc(**more: Any) -> dict[str, Any]:
    return {"type": "OSC_POSE", **more}


JOINTS = {"type": "JOINT_POSITION"}
COMPOSITE = {
    "type": "BASIC",
    "body_parts": {"arms": {"right": JOINTS | {"input_type": "absolute"}, "left": osc()}, "torso": JOINTS},
}

# controller_configs, width, how many entries are the arm's, and whether they are targets
CONTROLLERS: list[tuple[Any, int, int, bool]] = [
    (None, 7, 6, False),
    (osc(), 7, 6, False),
    ([osc()], 7, 6, False),
    (osc(impedance_mode="variable"), 19, 18, False),
    (osc(impedance_mode="variable_kp"), 13, 12, False),
    ({"type": "OSC_POSITION"}, 4, 3, False),
    ({"type": "IK_POSE"}, 7, 6, False),
    (JOINTS, 8, 7, False),
    (JOINTS | {"impedance_mode": "variable_kp"}, 15, 14, False),
    (JOINTS | {"input_type": "delta"}, 8, 7, False),
    (JOINTS | {"input_type": "absolute"}, 8, 7, True),
    ({"type": "JOINT_VELOCITY"}, 8, 7, False),
    ({"type": "BASIC", "body_parts": {"right": osc()}}, 7, 6, False),
    ({"type": "BASIC", "body_parts": {"arms": {"right": osc()}}}, 7, 6, False),
    (COMPOSITE, 8, 7, True),
]


@pytest.mark.parametrize(("configs", "width", "arm", "targets"), CONTROLLERS)
def test_the_grippers_entry_is_what_the_controller_leaves(configs: Any, width: int, arm: int, targets: bool) -> None:
    kwargs = {"robots": ["Panda"], "controller_configs": configs}
    body = load_embodiment(ROBOT)
    actions = bind_actions(action_entries(kwargs, body, width, "file"), body, [str(i) for i in range(width)])
    assert actions.column[-1] == arm and actions.kinds[-1] == "open_close"
    assert set(actions.kinds[:-1]) == {"absolute" if targets else "next_state"}
    if targets:
        assert actions.column[:-1].tolist() == list(range(7))
    for wrong in (width - 1, width + 2):
        with pytest.raises(CEIError, match=rf"actions has {wrong} entries, but \w+ takes {arm}, which leaves"):
            action_entries(kwargs, body, wrong, "file")


def test_what_does_not_add_up_says_how_to_say_it(tmp_path: Path) -> None:
    """The line that a refusal gives is one that works."""
    body = load_embodiment(ROBOT)
    with pytest.raises(CEIError) as error:
        action_entries({}, body, 9, "demo.hdf5")
    message = str(error.value)
    assert message.startswith(
        "demo.hdf5: actions has 9 entries, but OSC_POSE takes 6, which leaves 3 for the gripper PandaGripper, where it takes 1"
    )
    line = message[message.index("action: {") : message.rindex(", or action: null")]
    path, root = tmp_path / "map.yaml", tmp_path / "demo.hdf5"
    path.write_text(line)
    write(root, np.tile(body.home, (12, 1)), np.column_stack([np.zeros((12, 8)), np.ones(12)]))
    with pytest.raises(CEIError, match="actions has 9 entries"):
        open_source("lab/lift", root, embodiment=ROBOT)
    read = open_source("lab/lift", root, embodiment=ROBOT, joint_map=path).read(0)
    np.testing.assert_array_equal(read.action[:, 7:], 0)
    path.write_text("action: null")
    read = open_source("lab/lift", root, embodiment=ROBOT, joint_map=path).read(0)
    np.testing.assert_array_equal(read.action, read.qpos)


@pytest.mark.parametrize("hand", ["Inspire", "FourierRight", "FourierLeft"])
def test_a_hands_entries_are_where_robosuite_sends_its_motors(hand: str) -> None:
    """Against robosuite's own classes: they copy entries to motors, and scale them to what each may be told."""
    from robosuite.models.grippers import GRIPPER_MAPPING

    body = load_embodiment(f"Panda-{hand}")
    assert body.end_effector is not None
    entries = np.random.default_rng(0).uniform(-1, 1, 6)
    own = GRIPPER_MAPPING[body.end_effector.simulator_name]().format_action(entries)
    motors = [motor for motor in body.motors if motor[0] >= body.n_arm]
    sent = {q: (low + high) / 2 + (high - low) / 2 * x for (q, low, high), x in zip(motors, own, strict=True)}
    actions = bind_actions(action_entries({}, body, 12, "file"), body, [str(i) for i in range(12)])
    told = actions.absolute(np.concatenate([np.zeros(6), entries])[None])[0]
    for u, q in enumerate(body.coupled.independent):
        if q >= body.n_arm:
            assert told[u] == pytest.approx(sent[int(q)])


def test_fingers_of_their_own_close_by_the_sign_of_their_entries() -> None:
    body = load_embodiment("UR5e-RobotiqThreeFinger")
    actions = bind_actions(action_entries({}, body, 10, "file"), body, [str(i) for i in range(10)])
    qpos = np.tile(body.home, (4, 1))
    values = np.zeros((4, 10))
    values[:, 6:] = [0.3, -1, 0.01, 1]
    told = dict(zip(body.joint_names, actions.targets(values, qpos, 20.0)[0], strict=True))
    assert [told[f"finger_{name}_joint_1"] for name in ("1", "2", "middle")] == [1.0, 0.0, 1.0]
    assert told["palm_finger_1_joint"] == 0.0  # which is the same open and closed


def write(path: Path, qpos: np.ndarray, actions: np.ndarray, **more: np.ndarray) -> None:
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "env_kwargs": {"control_freq": 20, "robots": "Panda"}})
        data["demo_0/obs/robot0_joint_pos"], data["demo_0/obs/robot0_gripper_qpos"] = qpos[:, :7], qpos[:, 7:]
        data["demo_0/actions"] = actions
        for name, values in more.items():
            data[f"demo_0/{name}"] = values


def test_rewards_and_instructions_are_carried(tmp_path: Path) -> None:
    body, root = load_embodiment(ROBOT), tmp_path / "demo.hdf5"
    reward, done = np.arange(12) / 11, np.arange(12) == 11
    write(
        root,
        np.tile(body.home, (12, 1)),
        np.zeros((12, 7)),
        rewards=reward,
        dones=done.astype(int),
        states=np.zeros((12, 40)),
    )
    with h5py.File(root, "a") as file:
        file["data/demo_0"].attrs["ep_meta"] = json.dumps({"lang": "lift the cube"})
    source = open_source("lab/lift", root, embodiment=ROBOT)
    carried = source.carry(0)
    np.testing.assert_allclose(carried.columns["next.reward"], reward, atol=1e-6)
    np.testing.assert_array_equal(carried.columns["next.done"], done)
    assert source.read(0).task == "lift the cube"
    reason = "the simulator's, the source robot in it, and without model_file nobody knows what is where"
    assert source.dropped == {"states": reason}


# the table


def low(frames: int = 12, z_m: float = 0.0) -> np.ndarray:
    """(T, 9) a hand that goes down beside its base; home otherwise."""
    body = load_embodiment(ROBOT)
    qpos = np.tile(body.home, (frames, 1))
    qpos[:, 1] += np.linspace(0, z_m, frames)
    return qpos


def tool_height(qpos: np.ndarray) -> float:
    """Height of the lowest point of a hand's collision geometry, base frame: by MuJoCo's own kinematics."""
    import mujoco

    model = load_embodiment(ROBOT).model
    data, lowest = mujoco.MjData(model), np.inf
    hand = [
        g
        for g in range(model.ngeom)
        if model.geom_contype[g] and model.body(model.geom_bodyid[g]).name.startswith("ee/")
    ]
    for q in qpos:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        for g in hand:
            if (mesh := model.geom_dataid[g]) >= 0:
                first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
                points = model.mesh_vert[first : first + count]
            else:
                assert model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX
                points = model.geom_size[g] * (2 * np.indices((2, 2, 2)).reshape(3, 8).T - 1)
            points = points @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g]
            lowest = min(lowest, float(points[:, 2].min()))
    return lowest


def converted_table(root: Path, out: Path, capsys: pytest.CaptureFixture, *options: str) -> tuple[float, dict, str]:
    """The table of a converted dataset, what its metadata says of it, and what was said."""
    args = [
        "--dataset.repo_id=lab/lift",
        f"--dataset.root={root}",
        "--target=UR5e-PandaGripper",
        "--new_repo_id=me/out",
    ]
    quick = ["--init.starts=8", "--init.basins=1", "--allow_unreachable", f"--new_root={out}", f"--source={ROBOT}"]
    capsys.readouterr()
    assert convert.main([*args, *quick, *options]) == 0
    made = json.loads((out / "meta/cei.json").read_text())
    text = " ".join((capsys.readouterr().err + (out / "README.md").read_text()).split())
    return made["scene"]["table_z_m"], made["provenance"]["options"]["table"], text


@pytest.fixture
def reaching(tmp_path: Path) -> Path:
    """Two demonstrations, of which the second goes lower than the base stands."""
    root = tmp_path / "demo.hdf5"
    write(root, low(), np.zeros((12, 7)))
    qpos = low(z_m=1.35)
    with h5py.File(root, "a") as file:
        file["data/demo_1/obs/robot0_joint_pos"], file["data/demo_1/obs/robot0_gripper_qpos"] = qpos[:, :7], qpos[:, 7:]
        file["data/demo_1/actions"] = np.zeros((12, 7))
    return root


def test_a_table_that_nobody_gives_is_the_lowest_that_the_source_reached(
    reaching: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    z_m, said, text = converted_table(reaching, tmp_path / "a", capsys, "--source_pose=0,0,0.9", "--episodes=0")
    assert z_m == pytest.approx(0.9 + tool_height(low(z_m=1.35)), abs=2e-3) and z_m < 0.8
    assert said == {"z_m": z_m, "said_by": "the source's lowest point"}
    assert (
        f"warning: nothing says where the table is, so it is taken to be at {z_m:g} m" in text
        and "give --table_z_m" in text
    )
    assert f"The table is taken to be at {z_m:g} m (world), by the source's lowest point." in text


def test_a_table_that_is_given_is_taken(reaching: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    z_m, said, text = converted_table(reaching, tmp_path / "a", capsys, "--source_pose=0,0,0.9", "--table_z_m=0.71")
    assert (z_m, said["said_by"]) == (0.71, "--table_z_m") and "warning" not in text
    path = tmp_path / "table.yaml"
    path.write_text(yaml.safe_dump({"workspace_world": [[-1, -1, 0.6], [1, 1, 2]], "T_world_base": np.eye(4).tolist()}))
    z_m, said, text = converted_table(reaching, tmp_path / "b", capsys, f"--calibration={path}")
    assert (z_m, said) == (None, {"z_m": 0.6, "said_by": "the calibration's workspace"}) and "warning" not in text
    z_m, said, _ = converted_table(reaching, tmp_path / "c", capsys, f"--calibration={path}", "--table_z_m=0.65")
    assert (z_m, said["said_by"]) == (0.65, "--table_z_m")
    args = [
        "--dataset.repo_id=lab/lift",
        f"--dataset.root={reaching}",
        "--target=UR5e-PandaGripper",
        f"--source={ROBOT}",
    ]
    assert convert.main([*args, "--dry_run", "--table_z_m=nan"]) == 2
    assert "--table_z_m=nan should be a finite number." in capsys.readouterr().err


def test_a_table_is_not_above_where_the_robot_stands(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    root = tmp_path / "demo.hdf5"
    write(root, low(), np.zeros((12, 7)))  # at home, where nothing is lower than its first link
    z_m, said, _ = converted_table(root, tmp_path / "a", capsys)
    assert z_m == 0 and said["said_by"] == "the source's lowest point"


EYE = np.eye(4).tolist()
PARTS: list[tuple[dict[str, Any], Callable[[Any], bool]]] = [
    ({"T_world_base": EYE}, lambda s: s.table_from == ""),
    ({"cameras": None, "T_world_base": EYE}, lambda s: s.table_from == ""),
    (
        {"workspace_world": [[-1, -1, 0.6], [1, 1, 2]]},
        lambda s: s.scene.support_z_m == 0.6 and s.scene.T_world_base[2, 3] == 0,
    ),
    ({"cameras": {}, "workspace_world": [[-1, -1, 0.6], [1, 1, 2]]}, lambda s: s.scene.cameras == ()),
]


@pytest.mark.parametrize(("parts", "holds"), PARTS)
def test_a_calibration_of_any_parts_is_fine(parts: dict, holds: Callable[[Any], bool], tmp_path: Path) -> None:
    root, path = tmp_path / "demo.hdf5", tmp_path / "table.yaml"
    write(root, low(), np.zeros((12, 7)))
    path.write_text(yaml.safe_dump(parts))
    assert holds(open_source("lab/lift", root, embodiment=ROBOT, calibration=load_calibration(path)))


# physics


@shared
@pytest.mark.parametrize(("target", "known"), [("UR5e-FourierRight", False), ("IIWA-Inspire", True)])
def test_what_robosuite_recorded_holds_the_cube_in_physics(target: str, known: bool) -> None:
    """From where the file has the cube, in PickCube rebuilt by hand: both demonstrations, with a calibration and without."""
    from cei_converters.conversion.survey import LOWEST, survey
    from cei_converters.simulation.stage import Stage

    T_world_base = np.eye(4)
    T_world_base[:3, 3] = [float(x) for x in BASE.split(",")]
    given = {"calibration": load_calibration(TABLE)} if known else {"T_world_base": T_world_base}
    source = open_source("lab/lift", LIFT, embodiment=ROBOT, **given)
    if not known:
        found = survey(source, range(2))
        assert found == pytest.approx(0.8125, abs=1e-3)  # the table is at 0.8; nobody touched it
        source.set_table(found, LOWEST)
    demonstrations = list(source)
    transfer = Transfer(source.embodiment, load_embodiment(target))
    transfer.fit(demonstrations)
    with Stage(f"CEI-PickCube-{target}") as stage:
        for recorded in demonstrations:
            assert recorded.environment_state is not None
            position, quaternion_xyzw = np.split(recorded.environment_state[0][:7], [3])
            half_m = 0.021  # robosuite draws 20 to 22 mm
            cube = [*position, *np.roll(quaternion_xyzw, 1), *[half_m] * 3, 8 * half_m**3 * 1000]
            moved, report = transfer(recorded, clouds=False)
            assert report.penetration_mm.max() < 2
            state = {"environment_state": np.tile(cube, (len(moved), 1)), "environment_state_names": ()}
            entry, _ = stage.play(replace(moved, **state))
            assert entry["success"], entry


@shared
def test_robosuites_gripper_is_told_what_it_was(tmp_path: Path) -> None:
    source = open_source("lab/lift", LIFT, embodiment=ROBOT, calibration=load_calibration(TABLE))
    for index, demonstration in enumerate(source):
        with h5py.File(LIFT) as file:
            command = file[f"data/demo_{index}/actions"][:, -1]
        np.testing.assert_array_equal(demonstration.action[:, 7], np.where(command > 0, 0.0, 0.04))
        np.testing.assert_array_equal(demonstration.action[:-1, :7], demonstration.qpos[1:, :7])
    assert source.scene.support_z_m == pytest.approx(0.804)
