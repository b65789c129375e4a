"""Depth becomes clouds, whoever stored it; pictures pass through, pixel for pixel."""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from conversions import records

from cei_converters import convert
from cei_converters.dataset import schema
from cei_converters.sources.calibration import FORMAT, load_calibration
from cei_converters.sources.reader import DatasetReader
from cei_gym.demonstration import Camera, Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError

ROBOT, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
HEIGHT, WIDTH = 48, 64
FPS = 20
VIDEO, IMAGE = "observation.images.front", "observation.images.wrist"
DEPTH_VIDEO, DEPTH_IMAGE = "observation.images.top_depth", "observation.depth.side"
LENGTHS = (6, 9, 5)
FAST = 1  # the episode that the target is too slow for
LOOKING_DOWN = {"position": [0.5, 0.0, 2.0], "quaternion_wxyz": [0.0, 1.0, 0.0, 0.0]}
CAMERA = {
    "width": WIDTH,
    "height": HEIGHT,
    "K": {"fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0},
    "T_world_camera": LOOKING_DOWN,
}


def picture_feature(dtype: str, channels: int) -> dict:
    info = {"is_depth_map": True} if channels == 1 else {}
    names = ["height", "width", "channels"]
    return {"dtype": dtype, "shape": (HEIGHT, WIDTH, channels), "names": names, "info": info}


def write(root: Path, features: dict[str, dict], lengths: Sequence[int], frame: Callable[[int, int], dict]) -> Path:
    """A dataset as LeRobot itself writes it."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    body = load_embodiment(ROBOT)
    joints = {"dtype": "float32", "shape": (len(body.joint_names),), "names": schema.joint_feature_names(body)}
    features = {schema.STATE: joints, schema.ACTION: joints, **features}
    dataset = LeRobotDataset.create("me/pick", fps=FPS, features=features, root=root, robot_type="panda")
    for episode, length in enumerate(lengths):
        for t in range(length):
            qpos = body.home.astype(np.float32)
            qpos[0] += 0.1 * max(t - 4, 0) * (episode == FAST)  # 2 rad/s; the target has 1.5
            dataset.add_frame({schema.STATE: qpos, schema.ACTION: qpos, "task": "pick", **frame(episode, t)})
        dataset.save_episode()
    dataset.finalize()
    return root


def picture(episode: int, t: int) -> np.ndarray:
    """(H, W, 3) that no other frame has."""
    rows, columns = np.indices((HEIGHT, WIDTH))
    return np.stack([rows * 5, columns * 3, np.full_like(rows, 60 * episode + 6 * t)], axis=-1).astype(np.uint8)


def depth_m(t: int) -> np.ndarray:
    """(H, W, 1) of a slope that comes nearer; unknown in a corner."""
    depth = np.linspace(0.8, 2.0, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH, 1) - 0.01 * t
    depth[:4, :4] = 0
    return depth


def all_cameras(episode: int, t: int) -> dict[str, np.ndarray]:
    return {
        VIDEO: picture(episode, t),
        IMAGE: picture(episode, t),
        DEPTH_VIDEO: np.rint(1000 * depth_m(t)).astype(np.uint16),
        DEPTH_IMAGE: depth_m(t).astype(np.float32),
    }


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    features = {
        VIDEO: picture_feature("video", 3),
        IMAGE: picture_feature("image", 3),
        DEPTH_VIDEO: picture_feature("video", 1),
        DEPTH_IMAGE: picture_feature("image", 1),
    }
    return write(tmp_path_factory.mktemp("source") / "pick", features, LENGTHS, all_cameras)


@pytest.fixture(scope="module")
def rgb_source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    features = {VIDEO: picture_feature("video", 3), IMAGE: picture_feature("image", 3)}
    root = tmp_path_factory.mktemp("rgb") / "pick"
    return write(root, features, LENGTHS, lambda e, t: {VIDEO: picture(e, t), IMAGE: picture(e, t)})


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("calibration") / "cameras.yaml"
    workspace = [[-0.5, -1.0, -0.5], [1.5, 1.0, 1.5]]
    path.write_text(yaml.safe_dump({"cameras": {"top_depth": CAMERA, "side": CAMERA}, "workspace_world": workspace}))
    return path


SMALL = ("--clouds.points=64", "--clouds.robot_points=512", "--check_clouds=false")  # pictures show no robot


def run(root: Path, out: Path, *options: str) -> int:
    """What `options` say of the robots wins."""
    robots = [f"--source={ROBOT}", f"--target={TARGET}"]
    given = {option.partition("=")[0] for option in options}
    return convert.main(
        [
            "--dataset.repo_id=me/pick",
            f"--dataset.root={root}",
            *(option for option in robots if option.partition("=")[0] not in given),
            "--new_repo_id=me/out",
            f"--new_root={out}",
            "--init.starts=8",
            "--init.basins=1",
            *options,
        ]
    )


@pytest.fixture(scope="module")
def converted(source: Path, calibration: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("converted") / "out"
    assert run(source, out, f"--calibration={calibration}", *SMALL) == 0
    return out


@pytest.fixture(scope="module")
def rgb_converted(rgb_source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rgb_converted") / "out"
    assert run(rgb_source, out, "--episodes=2,0", f"--json={out.parent / 'result.json'}") == 0
    return out


def episodes(root: Path) -> list[list[dict]]:
    """Every frame as LeRobot gives it, by episode."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("me/any", root, video_backend="pyav")
    found: list[list[dict]] = [[] for _ in range(dataset.num_episodes)]
    for item in (dataset[i] for i in range(len(dataset))):
        found[int(item["episode_index"])].append(item)
    return found


# depth


@pytest.mark.parametrize("dtype", ["image", "video"])
@pytest.mark.parametrize("unit", ["mm", "m"])
def test_depth_is_read_in_metres(dtype: str, unit: str, tmp_path: Path) -> None:
    def frame(_: int, t: int) -> dict[str, np.ndarray]:
        metres = depth_m(t).astype(np.float32)
        return {"observation.cam": np.rint(1000 * metres).astype(np.uint16) if unit == "mm" else metres}

    root = write(tmp_path / "pick", {"observation.cam": picture_feature(dtype, 1)}, (4, 3), frame)
    info = json.loads((root / "meta/info.json").read_text())
    assert info["features"]["observation.cam"]["info"]["depth_unit"] == unit
    path = tmp_path / "cameras.yaml"
    path.write_text(yaml.safe_dump({"cameras": {"cam": CAMERA}}))
    reader = DatasetReader("me/pick", root, embodiment=ROBOT, calibration=load_calibration(path))
    for episode in reader:
        expected = np.stack([depth_m(t)[..., 0] for t in range(len(episode))])
        read = episode.depth_m["cam"]
        assert read.dtype == np.float32
        np.testing.assert_array_equal(read == 0, expected == 0)  # unknown stays unknown
        atol = 2e-3 if dtype == "video" else 5.1e-4 if unit == "mm" else 1e-6  # LeRobot's 12 bits; whole millimetres
        np.testing.assert_allclose(read, expected, atol=atol)


def test_depth_that_is_not_finite_is_unknown(tmp_path: Path) -> None:
    hole = depth_m(0).astype(np.float32)
    hole[10, 10], hole[11, 11] = np.nan, np.inf
    root = write(
        tmp_path / "pick", {"observation.cam": picture_feature("image", 1)}, (3,), lambda *_: {"observation.cam": hole}
    )
    path = tmp_path / "cameras.yaml"
    path.write_text(yaml.safe_dump({"cameras": {"cam": CAMERA}}))
    reader = DatasetReader("me/pick", root, embodiment=ROBOT, calibration=load_calibration(path))
    read = reader.read(0).depth_m["cam"]
    assert np.isfinite(read).all()
    assert (read[:, [10, 11], [10, 11]] == 0).all()


def test_depth_becomes_clouds(source: Path, converted: Path) -> None:
    first = episodes(converted)[0]
    assert first[0]["observation.point_cloud"].shape == (3 * 64,)
    assert not {DEPTH_VIDEO, DEPTH_IMAGE} & set(first[0])
    # both cameras look down from 2 m at a slope between 0.8 and 2 m away
    cloud = first[0]["observation.point_cloud"].numpy().reshape(64, 3)
    slope = cloud[np.abs(cloud[:, 1]) > 0.25]  # away from the robot
    assert len(slope) > 10
    assert (slope[:, 2] > -0.01).all()
    assert (slope[:, 2] < 1.21).all()
    card = (converted / "README.md").read_text()
    assert "made from the depth of `top_depth`, `side`." in card


def test_depth_without_calibration(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert run(source, tmp_path / "sub/out") == 1
    message = capsys.readouterr().err
    assert message.startswith(
        f"error: {DEPTH_VIDEO} has no calibration: no camera is calibrated; give width, height, K"
    )
    assert "'top_depth' with --calibration=FILE.yaml" in message
    assert message.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def edited(root: Path, copy: Path, edit: Callable[[dict], object]) -> Path:
    """A copy of a dataset with another meta/info.json."""
    shutil.copytree(root, copy)
    info = json.loads((copy / "meta/info.json").read_text())
    edit(info)
    (copy / "meta/info.json").write_text(json.dumps(info))
    return copy


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda f: f[DEPTH_VIDEO].update(shape=[10, 10, 1]), "calibrated for 64x48: it should be (48, 64, 1)"),
        (lambda f: f[DEPTH_IMAGE]["info"].update(depth_unit="cm"), "unknown depth_unit of observation.depth.side 'cm'"),
        (lambda f: f[DEPTH_IMAGE].update(dtype="float32"), "stored as float32; it should be image or video"),
        (lambda f: f.update({"observation.other.side": f[DEPTH_IMAGE]}), "two depth features are of one camera"),
    ],
)
def test_depth_that_cannot_be_used(
    source: Path, calibration: Path, tmp_path: Path, edit: Callable, message: str
) -> None:
    root = edited(source, tmp_path / "pick", lambda info: edit(info["features"]))
    with pytest.raises(CEIError) as error:
        DatasetReader("me/pick", root, embodiment=ROBOT, calibration=load_calibration(calibration))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_legacy_mark_of_depth(source: Path, calibration: Path, tmp_path: Path) -> None:
    def old(info: dict) -> None:
        marked = info["features"][DEPTH_VIDEO]["info"]
        marked["video.is_depth_map"] = marked.pop("is_depth_map")

    root = edited(source, tmp_path / "pick", old)
    reader = DatasetReader("me/pick", root, embodiment=ROBOT, calibration=load_calibration(calibration))
    assert set(reader.depth_cameras) == {"top_depth", "side"}
    assert set(reader.cameras) == {VIDEO, IMAGE}


def test_damaged_depth_video(source: Path, calibration: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(source, tmp_path / "pick"))
    (root / f"videos/{DEPTH_VIDEO}/chunk-000/file-000.mp4").write_bytes(b"no video")
    reader = DatasetReader("me/pick", root, embodiment=ROBOT, calibration=load_calibration(calibration))
    with pytest.raises(CEIError, match="cannot be decoded"):
        reader.read(0)


# calibration


def good() -> dict[str, Any]:
    return {"cameras": {"top_depth": {**CAMERA, "K": dict(CAMERA["K"])}, "side": dict(CAMERA)}}


def test_calibration_can_be_written_in_two_ways(tmp_path: Path) -> None:
    long = {
        **CAMERA,
        "K": [[60.0, 0.0, 32.0], [0.0, 60.0, 24.0], [0.0, 0.0, 1.0]],
        "T_world_camera": [[1, 0, 0, 0.5], [0, -1, 0, 0], [0, 0, -1, 2.0], [0, 0, 0, 1]],
    }
    path = tmp_path / "cameras.yaml"
    path.write_text(yaml.safe_dump({"cameras": {"short": CAMERA, "long": long}}))
    long, short = load_calibration(path).cameras
    assert (long.name, short.name, long.width, long.height) == ("long", "short", WIDTH, HEIGHT)
    np.testing.assert_allclose(short.K, long.K)
    np.testing.assert_allclose(short.T_world_camera, long.T_world_camera, atol=1e-12)


def test_the_documented_calibration_is_one(tmp_path: Path) -> None:
    path = tmp_path / "cameras.yaml"
    path.write_text(FORMAT.partition("\n")[2])
    calibration = load_calibration(path)
    np.testing.assert_allclose(calibration.T_world_base, np.eye(4))
    # it looks back and down
    forward = calibration.cameras[0].T_world_camera[:3, 2]
    np.testing.assert_allclose(np.linalg.norm(forward), 1)
    assert forward[2] <= 0.01


def test_calibration_wins_over_the_scene(calibration: Path) -> None:
    old = Camera("side", 8, 8, np.eye(3), np.eye(4))
    other = Camera("other", 8, 8, np.eye(3), np.eye(4))
    base = np.eye(4) + np.eye(4, k=3)
    scene = load_calibration(calibration).over(Scene(base, (old, other), np.array([[0.0] * 3, [1.0] * 3])))
    assert [(camera.name, camera.width) for camera in scene.cameras] == [("side", 64), ("other", 8), ("top_depth", 64)]
    np.testing.assert_array_equal(scene.T_world_base, base)
    np.testing.assert_array_equal(scene.workspace_world[0], [-0.5, -1.0, -0.5])


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda c: c.clear(), "says nothing; it should have at least one of cameras, workspace_world, T_world_base."),
        (lambda c: c.update(cameras=[]), "cameras should map each camera's name to width, height, K"),
        (lambda c: c.update(camera=1), "unknown field 'camera'. Did you mean 'cameras'? Valid: cameras, workspace"),
        (lambda c: c["cameras"].update(side=3), "camera 'side' should be a mapping with width, height, K"),
        (lambda c: c["cameras"]["side"].update(widht=3), "unknown field 'widht'. Did you mean 'width'?"),
        (lambda c: c["cameras"]["side"].pop("K"), "camera 'side': K missing"),
        (lambda c: c["cameras"]["side"].update(width="640"), "width should be a whole number of pixels, not '640'"),
        (lambda c: c["cameras"]["side"].update(width=0), "size 0x48 should be positive"),
        (lambda c: c["cameras"]["side"].update(K=[[1, 2], [3]]), "K should be numbers in rows of equal length"),
        (lambda c: c["cameras"]["side"].update(K=[[60, 0, 32], [0, 60, 24]]), "K should be 3x3 [[fx, 0, cx]"),
        (
            lambda c: c["cameras"]["side"].update(K=[[60, 0, 0], [0, 60, 0], [32, 24, 1]]),
            "K should be 3x3 [[fx, 0, cx]",
        ),
        (lambda c: c["cameras"]["top_depth"]["K"].update(fx="wide"), "K.fx should be a number, not wide"),
        (lambda c: c["cameras"]["top_depth"]["K"].update(fx=-60), "fx and fy positive"),
        (lambda c: c["cameras"]["top_depth"]["K"].update(f=60), "K: unknown field 'f'"),
        (
            lambda c: c["cameras"]["side"].update(T_world_camera=[[1, 2], [3, 4]]),
            "T_world_camera should be a 4x4 rigid",
        ),
        (
            lambda c: c["cameras"]["side"].update(T_world_camera={"position": [0, 0, 1]}),
            "T_world_camera: quaternion_wxyz missing",
        ),
        (
            lambda c: c["cameras"]["side"].update(T_world_camera={**LOOKING_DOWN, "position": [0, 0]}),
            "T_world_camera.position should be 3 numbers, not [0, 0]",
        ),
        (
            lambda c: c["cameras"]["side"].update(T_world_camera={**LOOKING_DOWN, "quaternion_wxyz": [0, 0, 0, 0]}),
            "quaternion_wxyz should have length 1, not 0",
        ),
        (lambda c: c["cameras"]["side"].update(lag_s="late"), "lag_s should be a number, not late"),
        (lambda c: c["cameras"]["side"].update(lag_s=60), "lag_s should be at most 2 s, not 60"),
        (lambda c: c.update(workspace_world=[[1, 1, 1], [0, 0, 0]]), "workspace_world should be [[x, y, z] lower"),
        (lambda c: c.update(workspace_world=[0, float("nan"), 0]), "workspace_world should be numbers"),
        (lambda c: c.update(T_world_base=[[2, 0], [0, 2]]), "T_world_base should be a 4x4 rigid transform"),
    ],
)
def test_bad_calibrations(edit: Callable[[dict], object], message: str, tmp_path: Path) -> None:
    content = good()
    edit(content)
    path = tmp_path / "cameras.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(CEIError) as error:
        load_calibration(path)
    assert message in str(error.value)
    assert str(error.value).startswith("cameras.yaml")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["cameras: [", "!!python/object/apply:os.getcwd []", "\0"])
def test_calibrations_that_are_no_yaml(text: str, tmp_path: Path) -> None:
    path = tmp_path / "cameras.yaml"
    path.write_text(text)
    with pytest.raises(CEIError, match=r"calibration .* cannot be read") as error:
        load_calibration(path)
    assert "\n" not in str(error.value)
    with pytest.raises(CEIError, match="cannot be read"):
        load_calibration(tmp_path / "none.yaml")


def test_two_bases(rgb_source: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = tmp_path / "cameras.yaml"
    path.write_text(yaml.safe_dump({**good(), "T_world_base": np.eye(4).tolist()}))
    assert run(rgb_source, tmp_path / "out", f"--calibration={path}", "--source_pose=0,0,0") == 1
    assert "are the same thing; give one" in capsys.readouterr().err


def test_help_shows_a_calibration(capsys: pytest.CaptureFixture) -> None:
    assert convert.main(["--help"]) == 0
    assert FORMAT in capsys.readouterr().out


# pictures


def test_frames_taken_from_frames_are_still_the_episodes() -> None:
    qpos = np.arange(8.0).reshape(4, 2)
    whole = Demonstration(ROBOT, 20.0, qpos, qpos, Scene(np.eye(4), (), np.zeros((2, 3))))
    assert whole.at(np.arange(4)).source_frames is None
    taken = whole.at(np.array([0, 1, 1, 2, 3])).at(np.array([0, 2, 4]))
    np.testing.assert_array_equal(taken.source_frames, [0, 1, 3])
    np.testing.assert_array_equal(taken.at(np.arange(3)).source_frames, [0, 1, 3])


def test_pictures_pass_through(source: Path, converted: Path) -> None:
    theirs, ours = episodes(source), episodes(converted)
    shown = [record.get("source_frames") for record in records(converted)]
    assert [frames is not None for frames in shown] == [False, True, False]
    for index in (0, 2):
        for key in (VIDEO, IMAGE):
            for one, other in zip(theirs[index], ours[index], strict=True):
                np.testing.assert_array_equal(one[key], other[key])
    video = f"videos/{VIDEO}/chunk-000/file-000.mp4"
    assert (source / video).read_bytes() == (converted / video).read_bytes()


def test_repeated_frames_show_the_pictures_of_their_sources(source: Path, converted: Path) -> None:
    theirs, ours = episodes(source)[FAST], episodes(converted)[FAST]
    frames = records(converted)[FAST]["source_frames"]
    assert len(frames) == len(ours) > len(theirs)
    assert sorted(set(frames)) == list(range(len(theirs)))
    for frame, item in zip(frames, ours, strict=True):
        np.testing.assert_array_equal(item[IMAGE], theirs[frame][IMAGE])
        error = [float((item[VIDEO] - other[VIDEO]).abs().mean()) for other in theirs]
        assert error[frame] < 0.02  # of 1; it was encoded again
        assert int(np.argmin(error)) == frame
    card = (converted / "README.md").read_text()
    assert "In 1 of 3 episodes" in card
    assert "their videos were encoded again" in card


def test_selected_episodes_keep_their_pictures(rgb_source: Path, rgb_converted: Path) -> None:
    theirs, ours = episodes(rgb_source), episodes(rgb_converted)
    assert [len(episode) for episode in ours] == [5, 6]
    for index, episode in zip((2, 0), ours, strict=True):
        for key in (VIDEO, IMAGE):
            for one, other in zip(theirs[index], episode, strict=True):
                np.testing.assert_array_equal(one[key], other[key])
    assert len(list((rgb_converted / "videos").rglob("*.mp4"))) == 1


def test_stored_images_are_the_same_bytes(rgb_source: Path, rgb_converted: Path) -> None:
    theirs = DatasetReader("me/pick", rgb_source, embodiment=ROBOT).pictures(2).images[IMAGE]
    ours = DatasetReader("me/out", rgb_converted).pictures(0).images[IMAGE]
    assert ours.equals(theirs)


def test_statistics_and_features_are_the_sources(rgb_source: Path, rgb_converted: Path) -> None:
    from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

    source, ours = (LeRobotDatasetMetadata("me/any", root) for root in (rgb_source, rgb_converted))
    for key in (VIDEO, IMAGE):
        assert ours.features[key] == source.features[key]
        assert ours.stats[key].keys() == source.stats[key].keys()
        assert ours.stats[key]["mean"].shape == (3, 1, 1)
        assert int(ours.stats[key]["count"][0]) == LENGTHS[2] + LENGTHS[0]
    mean = DatasetReader("me/pick", rgb_source, embodiment=ROBOT).pictures(2).statistics[VIDEO]["mean"]
    np.testing.assert_allclose(mean[2, 0, 0], (120 + 6 * 2) / 255, atol=0.01)


def test_training_accepts_the_dataset(converted: Path) -> None:
    from lerobot.configs.default import DatasetConfig
    from lerobot.configs.train import TrainPipelineConfig
    from lerobot.datasets.factory import make_dataset
    from lerobot.policies.act.configuration_act import ACTConfig

    data = DatasetConfig(repo_id="me/out", root=str(converted), use_imagenet_stats=True, video_backend="pyav")
    policy = ACTConfig(chunk_size=4, n_action_steps=4, device="cpu", push_to_hub=False)
    dataset = make_dataset(TrainPipelineConfig(dataset=data, policy=policy))
    assert dataset[3][VIDEO].shape[-3:] == (3, HEIGHT, WIDTH)
    assert dataset.meta.stats[IMAGE]["mean"].shape == (3, 1, 1)


def test_rgb_only_is_said(rgb_converted: Path, rgb_source: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    card = (rgb_converted / "README.md").read_text()
    assert "There are no point clouds: the source has no depth, so it was converted in joints." in card
    assert f"Pictures of `{VIDEO}`, `{IMAGE}` are the source's" in card
    assert f"**they still show {ROBOT}, not {TARGET}**" in card
    assert "encoded again" not in card
    assert "the point clouds show it" not in card
    result = json.loads((rgb_converted.parent / "result.json").read_text())
    assert result["passed_through"] == [VIDEO, IMAGE]
    assert (result["depth_cameras"], result["dropped_features"]) == ([], {})
    assert run(rgb_source, tmp_path / "out", "--dry_run", "--episodes=0") == 0
    line = (
        "Neither depth nor clouds: converted in joints; passed through untouched, so they still show the source robot: "
    )
    assert f"{line}{VIDEO}, {IMAGE}." in capsys.readouterr().out.splitlines()


def test_a_converted_dataset_converts_again(converted: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    options = (f"--source={TARGET}", "--target=UR5e-FourierRight", "--episodes=1")
    assert run(converted, out, *options, *SMALL, "--allow_unreachable") == 0
    theirs, (ours,) = episodes(converted)[FAST], episodes(out)
    frames = records(out)[0].get("source_frames", range(len(theirs)))
    for frame, item in zip(frames, ours, strict=True):
        np.testing.assert_array_equal(item[IMAGE], theirs[frame][IMAGE])
    assert "Point clouds were made from the source's." in (out / "README.md").read_text()


def test_missing_videos(rgb_source: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    root = Path(shutil.copytree(rgb_source, tmp_path / "pick"))
    (path,) = (root / "videos").rglob("*.mp4")
    path.unlink()
    assert run(root, tmp_path / "sub/out", "--episodes=0") == 1
    message = capsys.readouterr().err
    assert "file-000.mp4 is missing; download the dataset with its videos." in message
    assert message.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["pick"]


def test_a_dataset_that_is_here_without_any_of_its_videos(
    rgb_source: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    root = Path(shutil.copytree(rgb_source, tmp_path / "pick"))
    shutil.rmtree(root / "videos")
    assert run(root, tmp_path / "out", "--episodes=0") == 0
    assert f"Not carried over, as the dataset is here without its videos: {VIDEO}." in capsys.readouterr().out
    assert VIDEO not in json.loads((tmp_path / "out/meta/info.json").read_text())["features"]


def test_nothing_says_where_a_video_is(rgb_source: Path, tmp_path: Path) -> None:
    root = edited(rgb_source, tmp_path / "pick", lambda info: info.update(video_path=None))
    with pytest.raises(CEIError, match=f"episode 1: pick/meta does not say where the video of {VIDEO} is"):
        DatasetReader("me/pick", root, embodiment=ROBOT).check_videos([1])


@pytest.mark.parametrize("path", ["../{video_key}/{chunk_index}/{file_index}.mp4", "/{video_key}.mp4"])
def test_no_path_leads_out_of_the_dataset(rgb_source: Path, tmp_path: Path, path: str) -> None:
    root = edited(rgb_source, tmp_path / "pick", lambda info: info.update(video_path=path))
    with pytest.raises(CEIError, match="leads out of the dataset"):
        DatasetReader("me/pick", root, embodiment=ROBOT).pictures(0)


def test_failure_in_the_middle_leaves_nothing(
    rgb_source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    root = edited(rgb_source, tmp_path / "pick", lambda _: None)
    video = root / f"videos/{VIDEO}/chunk-000/file-000.mp4"
    head, _, pictures = video.read_bytes().partition(b"mdat")
    video.write_bytes(head + b"mdat" + bytes(len(pictures)))
    before = sorted(tmp_path.rglob("*"))
    # copied for episode 0, undecodable for episode 1, whose frames repeat
    assert run(root, tmp_path / "sub/out", "--episodes=0,1") == 1
    assert "cannot be decoded" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before
