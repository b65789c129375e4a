"""Demonstrations in other formats: robomimic's HDF5, DemoGen's zarr with end-effector poses, LeRobot's v2.0 and v2.1."""

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import h5py
import killed
import numpy as np
import pytest
import yaml
import zarr
from other_formats import BODY, ROBOT, path_of, told, write_zarr

from cei_converters.sources.formats import open_source
from cei_converters.sources.joint_map import load_joint_map
from cei_gym.embodiment.meshes import visual_link_meshes
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.kinematics.inverse import follow_link
from cei_gym.pointcloud.mask import RobotMask

EXAMPLES = Path(__file__).parents[1] / "examples"
SHARED = Path(__file__).parents[2] / "shared/datasets"
EGG = SHARED / "demogen_egg.zarr"


def test_robomimic_is_read_and_converted(robomimic: Path, tmp_path: Path) -> None:
    source = open_source("lab/lift", robomimic, embodiment=ROBOT)
    assert (len(source), source.fps, [source.frames(i) for i in range(3)]) == (3, 20.0, [6, 8, 16])
    last = source.read(2)  # demo_10 comes after demo_2
    np.testing.assert_array_equal(last.qpos, path_of(16, seed=10))
    np.testing.assert_array_equal(last.action[:-1, :7], last.qpos[1:, :7])
    np.testing.assert_array_equal(last.action[:, 7], np.where(told(last.qpos) > 0, 0.0, 0.04))
    np.testing.assert_array_equal(last.action[:, 8], -last.action[:, 7])
    assert last.task == "Lift" and last.environment_state is not None and (last.environment_state == 10).all()
    assert source.dropped == {"agentview_image": "there is no reader for it in HDF5"}
    from cei_converters import convert

    args = [a for a in killed.arguments(robomimic, tmp_path / "out") if "repo_id=me/pick" not in a]
    assert convert.main([*args, "--dataset.repo_id=lab/lift", f"--source={ROBOT}"]) == 0
    made = open_source("me/out", tmp_path / "out")
    assert len(made) == 3 and len(made.read(0)) == 6


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda f: f.pop("data"), "has no episodes: the group 'data' is missing or empty."),
        (lambda f: f["data/demo_0"].pop("obs"), "demo_0, has no observations; make them with robomimic's"),
        (
            lambda f: f["data/demo_0/obs"].pop("robot0_joint_pos"),
            "lacks obs/robot0_joint_pos with a row of numbers a frame; it has: agentview_image",
        ),
        (lambda f: f["data"].attrs.pop("env_args"), "does not say how many frames a second it has"),
        (lambda f: f["data"].attrs.update(env_args="{"), "does not say how many frames a second it has"),
    ],
)
def test_robomimic_without_what_is_needed_is_refused(robomimic: Path, edit: Callable, message: str) -> None:
    with h5py.File(robomimic, "a") as file:
        edit(file)
    with pytest.raises(CEIError) as error:
        open_source("lab/lift", robomimic, embodiment=ROBOT)
    assert message in str(error.value)


def test_robomimic_of_another_robot_another_file_or_none_is_refused(robomimic: Path, tmp_path: Path) -> None:
    with pytest.raises(CEIError, match="has 9 joints but UR5e-Inspire has 18; choose another --source"):
        open_source("lab/lift", robomimic, embodiment="UR5e-Inspire")
    with pytest.raises(CEIError, match="does not say which robot it is of; name it with --source"):
        open_source("lab/lift", robomimic)
    with h5py.File(robomimic, "a") as file:  # another file's data are not read
        del file["data/demo_0/obs/robot0_joint_pos"]
        file["data/demo_0/obs/robot0_joint_pos"] = h5py.ExternalLink("secret.hdf5", "x")
    with pytest.raises(CEIError, match="lacks obs/robot0_joint_pos"):
        open_source("lab/lift", robomimic, embodiment=ROBOT)
    robomimic.write_bytes(robomimic.read_bytes()[:1000])
    with pytest.raises(CEIError, match="cannot be read as HDF5"):
        open_source("lab/lift", robomimic, embodiment=ROBOT)


POSE = """
embodiment: Panda-PandaGripper
fps: 10
pose: {columns: {start: 0, end: %d}, rotation: %s, unit: mm, frame: world, link: right_hand, tool: {position: [0, 0, 0.1]}}
joints: [{joints: [finger_joint1], columns: ["%d"], unit: normalised}]
"""


@pytest.mark.parametrize("rotation", ["quat_xyzw", "quat_wxyz", "rotvec", "euler_xyz", "rot6d"])
def test_poses_become_the_joints_that_reach_them(rotation: str, tmp_path: Path) -> None:
    from scipy.spatial.transform import Rotation

    recorded = path_of(8)
    T_world_base = np.eye(4)
    T_world_base[:3, 3], T_world_base[:3, :3] = (0.3, -0.2, 0.8), Rotation.from_euler("z", 40, degrees=True).as_matrix()
    tree, link = KinematicTree(BODY), BODY.body_id("right_hand")
    T = T_world_base @ tree.forward(recorded)[:, link]
    position_mm = 1e3 * (T[:, :3, 3] + 0.1 * T[:, :3, 2])
    R = Rotation.from_matrix(T[:, :3, :3])
    stored = {
        "quat_xyzw": R.as_quat(),
        "quat_wxyz": R.as_quat(scalar_first=True),
        "rotvec": R.as_rotvec(),
        "euler_xyz": R.as_euler("xyz"),
        "rot6d": np.concatenate([T[:, :3, 0], T[:, :3, 1]], axis=1),
    }[rotation]
    root, path = tmp_path / "demo.zarr", tmp_path / "map.yaml"
    write_zarr(root, np.column_stack([position_mm, stored, recorded[:, 7] / 0.04]), [8])
    count = 3 + stored.shape[1]
    path.write_text(POSE % (count, rotation, count))
    read = open_source("lab/demo", root, joint_map=path, T_world_base=T_world_base).read(0)
    np.testing.assert_allclose(tree.forward(read.qpos)[:, link], tree.forward(recorded)[:, link], atol=1e-6)
    np.testing.assert_allclose(read.qpos[:, 7:], recorded[:, 7:], atol=1e-7)
    assert read.figures["ik_position_mm"] < 1e-3 and read.figures["ik_angle_deg"] < 1e-3


def test_a_pose_out_of_reach_is_reported(tmp_path: Path) -> None:
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 0, 3] = 2.0
    found = follow_link(BODY, BODY.body_id("right_hand"), T)
    assert (found.position_m > 0.8).all()  # a Panda reaches 0.86 m
    assert (found.qpos >= BODY.lower - 1e-9).all() and (found.qpos <= BODY.upper + 1e-9).all()


def test_zarr_without_what_is_needed_is_refused(tmp_path: Path) -> None:
    root, path = tmp_path / "demo.zarr", tmp_path / "map.yaml"
    joints = {"joints": [{"joints": "arm", "columns": {"start": 0, "end": 7}}], "fixed": {"finger_joint1": 0.0}}
    path.write_text(yaml.safe_dump(joints | {"embodiment": ROBOT, "fps": 10.0}))
    write_zarr(root, path_of(6)[:, :7], [4, 6])
    source = open_source("lab/demo", root, joint_map=path)
    assert [len(d) for d in source] == [4, 2]
    with pytest.raises(CEIError, match="does not say what its columns are; say it with --joint_map"):
        open_source("lab/demo", root)
    write_zarr(root, path_of(6)[:, :7], [4, 7])
    with pytest.raises(CEIError, match="episode_ends should rise to the 6 frames"):
        open_source("lab/demo", root, joint_map=path)
    write_zarr(root, path_of(6)[:, :7], [6], **{"data/point_cloud": np.zeros((6, 5, 4), np.float32)})
    with pytest.raises(CEIError, match=r"should be \(6, points, 3 or 6\) numbers"):
        open_source("lab/demo", root, joint_map=path).read(0)
    pickled = json.loads((root / "data/state/.zarray").read_text()) | {"dtype": "|O", "filters": [{"id": "pickle"}]}
    (root / "data/state/.zarray").write_text(json.dumps(pickled))
    with pytest.raises(CEIError, match="data/state"):
        open_source("lab/demo", root, joint_map=path)


@pytest.mark.skipif(not EGG.exists(), reason="needs ../shared/datasets")
def test_the_eggs_joint_map_is_the_one_that_puts_the_robot_where_its_points_are(tmp_path: Path) -> None:
    """Of six orders of the angles and four turns of the hand, none explains half as many of the other points."""
    mapped = load_joint_map(EXAMPLES / "egg/joint_map.yaml")
    assert mapped.pose is not None
    mask, tree = RobotMask(visual_link_meshes(BODY.model), 0.01), KinematicTree(BODY)
    state = zarr.open_group(EGG, mode="r")["data/state"][:35]

    def share(pose) -> float:
        """Of the points of the hand, those within 1 cm of the robot."""
        path = tmp_path / "map.yaml"
        from cei_converters.dataset.metadata import plain

        path.write_text(yaml.safe_dump(plain(replace(mapped, pose=pose))))
        demonstration = open_source("demogen/egg", EGG, joint_map=path).read(0)
        assert demonstration.point_cloud_world is not None
        near = []
        for t in range(0, 35, 10):
            points = demonstration.point_cloud_world[t, :, :3]
            hand = points[points[:, 2] > state[t, 2] + 0.06]
            near.append(mask(hand, tree.forward(demonstration.qpos[t])))
        return float(np.concatenate(near).mean())

    ours = share(mapped.pose)
    others = [replace(mapped.pose, columns=["0", "1", "2", *order]) for order in permutations("345")]
    turns = ([0, 1, 0, 0], [1, 0, 0, 0], [0.7071, 0, 0, 0.7071])
    others += [replace(mapped.pose, tool=replace(mapped.pose.tool, quaternion_wxyz=list(turn))) for turn in turns]
    shares = sorted(share(pose) for pose in others if pose != mapped.pose)
    assert ours > 0.7
    assert shares[-1] < ours - 0.15, shares


def test_older_formats_are_read_as_they_are_and_left_alone(
    v21: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cei_converters.dataset.provenance import fingerprint

    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path))
    before = fingerprint(v21)
    source = open_source("me/old", v21, embodiment=ROBOT)
    for index, demonstration in enumerate(source):
        np.testing.assert_array_equal(demonstration.qpos, path_of(6 + index, seed=index).astype(np.float32))
        assert demonstration.task == "pick"
    assert fingerprint(v21) == before
    made = source.root
    assert open_source("me/old", v21, embodiment=ROBOT).root == made  # once
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("me/old", made)
    assert len(dataset) == 21
    np.testing.assert_allclose(
        dataset.meta.stats["observation.state"]["mean"], np.concatenate([d.qpos for d in source]).mean(0)
    )


def test_an_old_dataset_that_is_damaged_is_refused(v21: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import shutil

    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "home"))
    root = Path(shutil.copytree(v21, tmp_path / "broken"))
    data = root / "data/chunk-000/episode_000001.parquet"
    data.write_bytes(data.read_bytes()[:100])
    with pytest.raises(CEIError, match=r"cannot be converted to v3\.0"):
        open_source("me/old", root, embodiment=ROBOT)
    assert list((tmp_path / "home/upgraded").iterdir()) == []
    (root / "meta/tasks.jsonl").unlink()
    with pytest.raises(CEIError, match=r"says that its codebase_version is v2\.0, but has no meta/tasks\.jsonl"):
        open_source("me/old", root, embodiment=ROBOT)
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps(info | {"codebase_version": "v1.6"}))
    with pytest.raises(CEIError, match="has codebase_version 'v1"):
        open_source("me/old", root, embodiment=ROBOT)
