"""Datasets as strangers have them: names in any form, odd rates, episodes of one frame, hidden files, and paths that miss by a little."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
import zarr

from cei_converters import convert
from cei_converters.dataset.schema import feature_names, joint_feature_names
from cei_converters.dataset.starts import find_starts
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.sources.formats import open_source
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.untrusted import load_json, load_yaml
from lerobot_policy_dp3.clouds import bounds_of

ROBOT = "Panda-PandaGripper"
BODY = load_embodiment(ROBOT)
SCENE = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))


def write(root: Path, *lengths: int, fps: float = 20.0) -> Path:
    """A dataset of ours, of a robot that moves a little."""
    with DatasetWriter("me/pick", root) as writer:
        for index, length in enumerate(lengths):
            qpos = np.tile(BODY.home, (length, 1))
            qpos[:, 0] += 0.01 * np.arange(length) + 0.1 * index
            writer.add(Demonstration(ROBOT, fps, qpos, qpos, SCENE, "pick"))
    return root


def run(root: Path, out: Path, *options: str) -> int:
    args = ["--dataset.repo_id=me/pick", f"--dataset.root={root}", "--target=UR5e-PandaGripper", "--new_repo_id=me/out"]
    return convert.main(
        [*args, "--init.starts=8", "--init.basins=1", "--allow_unreachable", f"--new_root={out}", *options]
    )


# names


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a", "b"], ["a", "b"]),
        ([["a", "b"]], ["a", "b"]),
        ([["a"], ["b", "c"]], ["a", "b", "c"]),
        ({"motors": ["a", "b"]}, ["a", "b"]),
        ({"left": ["a", "b"], "right": ["a", "b"]}, ["left.a", "left.b", "right.a", "right.b"]),
        ({"arm": {"left": ["a"], "right": ["a"]}}, ["arm.left.a", "arm.right.a"]),
        ({"b": 1, "a": 0, "c": 2}, ["a", "b", "c"]),
        (["a", None, "c"], ["a", "1", "c"]),
        (None, []),
        ([None, None], []),
        ([], []),
    ],
)
def test_names_in_any_form(names: object, expected: list[str]) -> None:
    assert feature_names({"names": names}) == expected


@pytest.mark.parametrize(
    "form",
    [
        lambda names: [names],
        lambda names: {"motors": names},
        lambda names: {name: place for place, name in reversed(list(enumerate(names)))},
        lambda names: [[name] for name in names],
    ],
)
def test_names_in_any_form_are_the_joints(form: Callable[[list[str]], object], tmp_path: Path) -> None:
    root = write(tmp_path / "pick", 4)
    info = json.loads((root / "meta/info.json").read_text())
    for key in ("observation.state", "action"):
        info["features"][key]["names"] = form(joint_feature_names(BODY))
    (root / "meta/info.json").write_text(json.dumps(info))
    assert len(open_source("me/pick", root).read(0)) == 4


@pytest.mark.parametrize("names", [None, [None] * 9, [f"motor_{i}" for i in range(9)]])
def test_other_names_lead_to_a_joint_map(names: object, tmp_path: Path) -> None:
    root = write(tmp_path / "pick", 4)
    info = json.loads((root / "meta/info.json").read_text())
    info["features"]["observation.state"]["names"] = names
    (root / "meta/info.json").write_text(json.dumps(info))
    with pytest.raises(CEIError, match="--joint_map says which columns are which joints; cei-inspect proposes one"):
        open_source("me/pick", root)


def test_a_name_that_is_there_twice_is_no_name(tmp_path: Path) -> None:
    root, path = write(tmp_path / "pick", 4), tmp_path / "map.yaml"
    info = json.loads((root / "meta/info.json").read_text())
    for key in ("observation.state", "action"):
        info["features"][key]["names"] = [*"abcdefg", "grip", "grip"]
    (root / "meta/info.json").write_text(json.dumps(info))
    groups = [{"joints": "arm", "columns": list("abcdefg")}, {"joints": ["finger_joint1"], "columns": ["grip"]}]
    path.write_text(yaml.safe_dump({"joints": groups, "ignore": "rest"}))
    with pytest.raises(CEIError, match="several columns are named 'grip'; give their numbers"):
        open_source("me/pick", root, joint_map=path)
    groups[1]["columns"] = ["7"]
    path.write_text(yaml.safe_dump({"joints": groups, "ignore": "rest"}))
    np.testing.assert_allclose(open_source("me/pick", root, joint_map=path).read(0).qpos[0], BODY.home, atol=1e-6)


# rates and lengths


@pytest.mark.parametrize("fps", [29.97, 12.5, 30000 / 1001])
def test_a_rate_that_is_no_whole_number_stays(fps: float, tmp_path: Path) -> None:
    """And LeRobot reads windows of it."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root = write(tmp_path / "pick", 12, 9, fps=fps)
    assert run(root, tmp_path / "out", "--transfer.stretch=1") == 0
    made = open_source("me/out", tmp_path / "out")
    assert made.fps == fps and len(made.read(1)) == 9
    window = {"action": [i / fps for i in range(4)], "observation.state": [-1 / fps, 0.0]}
    dataset = LeRobotDataset("me/out", tmp_path / "out", delta_timestamps=window)
    item = dataset[14]
    assert dataset.fps == fps and item["timestamp"] == pytest.approx(2 / fps, rel=1e-5)
    np.testing.assert_allclose(item["action"], made.read(1).action[2:6], atol=1e-6)


def test_pictures_at_such_a_rate_are_encoded_at_it(tmp_path: Path) -> None:
    """Where frames repeat, a video is encoded again."""
    import av
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root, fps = tmp_path / "pick", 29.97
    joints = {"dtype": "float32", "shape": (9,), "names": joint_feature_names(BODY)}
    picture = {"dtype": "video", "shape": (48, 64, 3), "names": ["height", "width", "channels"]}
    features = {"observation.state": joints, "action": joints, "observation.images.front": picture}
    dataset = LeRobotDataset.create("me/pick", fps=30, features=features, root=root, robot_type="panda")
    for t in range(12):
        qpos = BODY.home.astype(np.float32)
        qpos[0] += 0.12 * max(t - 4, 0)
        dataset.add_frame(
            {
                "observation.state": qpos,
                "action": qpos,
                "task": "pick",
                "observation.images.front": np.full((48, 64, 3), 18 * t, np.uint8),
            }
        )
    dataset.save_episode()
    dataset.finalize()
    info = json.loads((root / "meta/info.json").read_text())
    (root / "meta/info.json").write_text(json.dumps(info | {"fps": fps}))
    assert run(root, tmp_path / "out", f"--source={ROBOT}") == 0
    made = open_source("me/out", tmp_path / "out")
    assert made.frames(0) > 12
    with av.open(str(next((tmp_path / "out/videos").rglob("*.mp4")))) as container:
        assert float(container.streams.video[0].average_rate or 0) == pytest.approx(fps, rel=1e-3)
        assert sum(1 for _ in container.decode(video=0)) == made.frames(0)


def test_an_episode_of_one_frame_converts(tmp_path: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root = write(tmp_path / "pick", 6, 1, 5)
    assert run(root, tmp_path / "out") == 0
    made = open_source("me/out", tmp_path / "out")
    assert [made.frames(i) for i in range(3)] == [6, 1, 5]
    stats = LeRobotDataset("me/out", tmp_path / "out").meta.stats
    assert stats is not None
    states = np.concatenate([made.read(i).qpos for i in range(3)])
    np.testing.assert_allclose(stats["observation.state"]["mean"], states.mean(0), atol=1e-5)
    np.testing.assert_allclose(stats["observation.state"]["std"], states.std(0), atol=1e-3)
    assert stats["observation.state"]["count"] == [12]


# hidden files


JUNK = b"\0\5\26\7\0\2\0\0Mac OS X        "


def test_hidden_files_are_no_data(tmp_path: Path) -> None:
    root = write(tmp_path / "pick", 6, 5)
    for place in ("", "meta", "meta/episodes/chunk-000", "data/chunk-000"):
        for name in ("._file-000.parquet", "._info.json", ".DS_Store", "._tasks.parquet"):
            (root / place / name).write_bytes(JUNK)
    (root / "meta/episodes/._chunk-000").write_bytes(JUNK)
    assert run(root, tmp_path / "out") == 0
    assert len(open_source("me/out", tmp_path / "out")) == 2


def test_hidden_files_of_older_formats_are_no_data(v21: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "home"))
    root = Path(shutil.copytree(v21, tmp_path / "pick"))
    (root / "videos/chunk-000/observation.images.top").mkdir(parents=True)
    for place in ("", "meta", "data", "data/chunk-000"):
        for name in ("._episode_000000.parquet", ".DS_Store", "._info.json"):
            (root / place / name).write_bytes(JUNK)
    (root / "videos/chunk-000/observation.images.top/._episode_000000.mp4").write_bytes(JUNK)
    for version in ("v2.0", "v2.1"):
        info = json.loads((root / "meta/info.json").read_text())
        picture = {"dtype": "video", "shape": [48, 64, 3], "names": ["height", "width", "channels"], "info": {}}
        info["features"]["observation.images.top"] = picture  # of which there is only a hidden file
        info["video_path"] = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
        (root / "meta/info.json").write_text(json.dumps(info | {"codebase_version": version}))
        if version == "v2.1":
            upgraded = next((tmp_path / "home/upgraded").iterdir())
            assert not any(path.name.startswith(".") for path in upgraded.rglob("*"))
            continue
        source = open_source("me/old", root, embodiment=ROBOT)
        assert len(source) == 3 and source.cameras == {}


# paths


def test_suffixes_in_capitals_are_the_same(robomimic: Path) -> None:
    for suffix in (".HDF5", ".H5", ".hdf"):
        path = robomimic.with_suffix(suffix)
        shutil.copyfile(robomimic, path)
        assert len(open_source("lab/lift", path, embodiment=ROBOT)) == 3
    bare = robomimic.with_suffix("")
    shutil.copyfile(robomimic, bare)  # told by its first bytes
    assert len(open_source("lab/lift", bare, embodiment=ROBOT)) == 3


def test_a_path_that_misses_by_a_little_is_put_right(robomimic: Path, tmp_path: Path) -> None:
    root = write(tmp_path / "sets/pick", 4)
    (tmp_path / "zarrs").mkdir()
    zarr.open_group(tmp_path / "zarrs/egg.zarr", mode="w", zarr_format=2)
    (tmp_path / "files").mkdir()
    shutil.copyfile(robomimic, tmp_path / "files/demo.HDF5")
    (tmp_path / "empty").mkdir()
    for name in ("egg.zarr.zip", "pick.tar.gz", "demo.zip"):
        (tmp_path / name).write_bytes(b"PK\3\4")
    (tmp_path / "notes.txt").write_text("x")
    cases = {
        root / "meta": f"is a folder, and no dataset by itself; give --dataset.root={root}",
        root / "data/chunk-000": f"give --dataset.root={root}",
        root / "meta/info.json": f"is a file of a dataset; give --dataset.root the dataset's folder, {root}",
        next(root.glob("data/*/*.parquet")): f"give --dataset.root the dataset's folder, {root}",
        tmp_path / "sets": f"give --dataset.root={root}",
        tmp_path / "zarrs": f"give --dataset.root={tmp_path / 'zarrs/egg.zarr'}",
        tmp_path / "zarrs/egg.zarr/.zgroup": f"the dataset's folder, {tmp_path / 'zarrs/egg.zarr'}",
        tmp_path / "files": f"give --dataset.root={tmp_path / 'files/demo.HDF5'}",
        tmp_path / "egg.zarr.zip": "is packed; unpack it, and give --dataset.root the folder or file that comes out",
        tmp_path / "pick.tar.gz": "is packed; unpack it",
        tmp_path / "notes.txt": "is of no format that is read: folders of LeRobot, HDF5",
        tmp_path / "empty": "no LeRobot dataset in",
        tmp_path / "none": "no LeRobot dataset in",
    }
    for path, message in cases.items():
        with pytest.raises(CEIError) as error:
            open_source("lab/any", path, embodiment=ROBOT)
        assert message in str(error.value)


# values


def test_yaml_is_read_by_its_core_schema() -> None:
    text = "{a: on, b: 1:30, c: 2024-01-01, d: 0x10, e: 1e-3, f: .5, g: -1, h: true, i: ~, j: '010', k: 1e400, l: !!float 1}"
    assert load_yaml(text) == {
        "a": "on",
        "b": "1:30",
        "c": "2024-01-01",
        "d": "0x10",
        "e": 0.001,
        "f": 0.5,
        "g": -1,
        "h": True,
        "i": None,
        "j": "010",
        "k": np.inf,
        "l": 1.0,
    }
    assert load_yaml("{a: &a {x: 1, y: 2}, b: {<<: *a, y: 3}}")["b"] == {"x": 1, "y": 3}
    for text in (
        "010",
        "!!timestamp 2024-01-01",
        "!!binary aGk=",
        "!!set {a}",
        "!!omap [a: 1]",
        "9" * 400,
        "!!bool yes",
        "!x 1",
    ):
        with pytest.raises(CEIError):
            load_yaml(f"a: {text}")
    with pytest.raises(CEIError, match="has 400 digits"):
        load_json('{"a": ' + "9" * 400 + "}")


def test_a_link_in_hdf5_that_nobody_needs_is_no_matter(robomimic: Path) -> None:
    """It is listed, and not followed."""
    with h5py.File(robomimic, "a") as file:
        file["data/demo_0/obs/elsewhere"] = h5py.ExternalLink("none.hdf5", "x")
    source = open_source("lab/lift", robomimic, embodiment=ROBOT)
    assert source.dropped["elsewhere"] == "a link, which is not followed"
    assert len(source.read(0)) == 6


def test_hidden_files_beside_data_say_nothing_of_starts_and_bounds(tmp_path: Path) -> None:
    root = write(tmp_path / "pick", 5, 6)
    starts, bounds = find_starts(root), bounds_of("action", 3, None, root)
    (root / "data/chunk-000/._file-000.parquet").write_bytes(JUNK)
    assert find_starts(root) == starts and bounds_of("action", 3, None, root) == bounds
    assert starts and bounds is not None


def test_zarr_of_the_third_format_is_read_by_codecs_of_numbers_alone(tmp_path: Path) -> None:
    root, state = tmp_path / "demo.zarr", np.tile(BODY.home, (8, 1))
    group = zarr.open_group(root, mode="w", zarr_format=3)
    group.create_array("data/state", data=state, chunks=(2, 9), shards=(4, 9))
    group.create_array("meta/episode_ends", data=np.array([5, 8]))
    (tmp_path / "map.yaml").write_text(
        yaml.safe_dump(
            {
                "embodiment": ROBOT,
                "fps": 20,
                "joints": [{"joints": list(BODY.joint_names), "columns": {"start": 0, "end": 9}}],
            }
        )
    )
    source = open_source("lab/demo", root, joint_map=tmp_path / "map.yaml")
    assert [len(demonstration) for demonstration in source] == [5, 3]
    np.testing.assert_array_equal(source.read(1).qpos, state[5:])
    described = json.loads((root / "data/state/zarr.json").read_text())
    (sharding,) = described["codecs"]
    sharding["configuration"]["codecs"].insert(0, {"name": "numcodecs.pickle", "configuration": {}})
    (root / "data/state/zarr.json").write_text(json.dumps(described))
    with pytest.raises(CEIError, match="stored by 'pickle', which is no codec of numbers"):
        open_source("lab/demo", root, joint_map=tmp_path / "map.yaml")
