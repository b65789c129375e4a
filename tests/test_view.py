"""`cei-view`: what a recording and a contact sheet show of an episode, alone and beside its source."""

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conversions import record_cubes
from PIL import Image

from cei_converters import convert
from cei_converters import view as cei_view
from cei_converters.dataset.records import RECORDS_PATH, Records
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.sources.reader import DatasetReader
from cei_converters.view.episode import NORMAL_M, View, load_view
from cei_converters.view.recording import save
from cei_converters.view.sheet import write_sheet
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import Embodiment, load_embodiment
from cei_gym.rendering import look_at, project, splat

SOURCE, TARGET = "Panda-PandaGripper", "IIWA-Inspire"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recorded episode, the same converted for a slower robot, and both shown."""
    folder = tmp_path_factory.mktemp("job")
    record_cubes(folder / "source", 1, 0)
    converted = [f"--target={TARGET}", "--new_repo_id=me/target", f"--new_root={folder / 'target'}"]
    quick = ["--init.starts=16", "--init.basins=1", "--solver.velocity_scale=0.5"]
    assert convert.main([*dataset(folder / "source"), *converted, *quick]) == 0
    shown = [f"--rrd={folder / 'view.rrd'}", f"--sheet={folder / 'view.png'}", f"--json={folder / 'view.json'}"]
    assert cei_view.main([*dataset(folder / "target"), *beside(folder / "source"), *shown]) == 0
    return folder


def dataset(root: Path) -> list[str]:
    return [f"--dataset.repo_id=me/{root.name}", f"--dataset.root={root}"]


def beside(root: Path) -> list[str]:
    return [f"--source.repo_id=me/{root.name}", f"--source.root={root}"]


@pytest.fixture(scope="module")
def episodes(job: Path) -> tuple[Demonstration, Demonstration, dict]:
    """Source, target, and what the metadata says of the target."""
    source, target = (DatasetReader(f"me/{name}", job / name) for name in ("source", "target"))
    return source.read(0), target.read(0), target.record(0)


@pytest.fixture(scope="module")
def chunks(job: Path) -> dict[str, list]:
    return read_chunks(job / "view.rrd")


def read_chunks(path: Path) -> dict[str, list]:
    """Entity path to its chunks of a recording."""
    from rerun.experimental import RrdReader

    found: dict[str, list] = {}
    for chunk in RrdReader(path).stream():
        found.setdefault(chunk.entity_path, []).append(chunk)
    return found


def columns(chunks: dict[str, list], path: str, static: bool = False) -> dict[str, list]:
    """A column's last name (`translation`, `frame`) to its values, a list an entity and a kind of chunk."""
    found: dict[str, list] = {}
    for chunk in chunks[path]:
        if chunk.is_static == static:
            batch = chunk.to_record_batch()
            for name, column in zip(batch.schema.names, batch.columns, strict=True):
                found.setdefault(name.split(":")[-1], []).extend(column.to_pylist())
    return found


def link_poses(embodiment: Embodiment, T_world_base: np.ndarray, qpos: np.ndarray) -> list[np.ndarray]:
    """(L, 4, 4) poses by MuJoCo itself at each of (T, n) joint positions."""
    data = mujoco.MjData(embodiment.model)
    poses = []
    for q in qpos:
        data.qpos[:] = q
        mujoco.mj_kinematics(embodiment.model, data)
        T = np.tile(np.eye(4), (embodiment.model.nbody, 1, 1))
        T[:, :3, :3], T[:, :3, 3] = data.xmat.reshape(-1, 3, 3), data.xpos
        poses.append(T_world_base @ T)
    return poses


def test_a_converted_episode_says_which_frames_of_its_source_it_shows(episodes) -> None:
    before, after, entry = episodes
    frames = entry["source_frames"]
    assert len(frames) == len(after) > len(before)  # a target this slow makes frames repeat
    assert sorted(set(frames)) == list(range(len(before)))
    np.testing.assert_array_equal(after.environment_state, before.environment_state[frames])


def test_recorded_transforms_are_forward_kinematics_of_both_robots_frame_by_frame(episodes, chunks) -> None:
    before, after, entry = episodes
    for role, name, demonstration in (
        ("source", SOURCE, before.at(np.array(entry["source_frames"]))),
        ("target", TARGET, after),
    ):
        body = load_embodiment(name)
        poses = link_poses(body, demonstration.scene.T_world_base, demonstration.qpos)
        for link, link_name in enumerate(body.body_names):
            found = columns(chunks, f"/{role}/robot/{link_name.replace('/', '_')}")
            assert found["frame"] == list(range(len(after)))
            T = np.array([pose[link] for pose in poses])
            np.testing.assert_allclose(np.array(found["translation"])[:, 0], T[:, :3, 3], atol=1e-5)
            rotation = np.array(found["mat3x3"])[:, 0].reshape(-1, 3, 3).swapaxes(1, 2)  # rerun keeps columns
            np.testing.assert_allclose(rotation, T[:, :3, :3], atol=1e-5)


def test_frames_are_a_step_of_the_dataset_apart(episodes, chunks) -> None:
    seconds = [time.total_seconds() for time in columns(chunks, "/target/pads/points")["time"]]
    np.testing.assert_allclose(np.diff(seconds), 1 / episodes[1].fps, atol=1e-6)


def test_meshes_are_recorded_once(chunks) -> None:
    for role in ("source", "target"):
        meshes = [path for path in chunks if path.startswith(f"/{role}/robot/")]
        static = [path for path in meshes if "vertex_positions" in columns(chunks, path, static=True)]
        assert len(static) > 8
        for path in static:
            found = columns(chunks, path, static=True)
            assert len(found["vertex_positions"]) == 1
            assert np.max(found["triangle_indices"][0]) < len(found["vertex_positions"][0])
            assert "vertex_positions" not in columns(chunks, path)


def test_pads_clouds_and_depth_are_recorded_frame_by_frame(episodes, chunks) -> None:
    before, after, entry = episodes
    for role, cloud in (
        ("source", before.point_cloud_world[entry["source_frames"]]),
        ("target", after.point_cloud_world),
    ):
        np.testing.assert_array_equal(columns(chunks, f"/{role}/cloud")["positions"], cloud)
        points = columns(chunks, f"/{role}/pads/points")["positions"]
        arrows = columns(chunks, f"/{role}/pads/normals")
        np.testing.assert_array_equal(arrows["origins"], points)
        assert np.shape(points) == (len(after), 64, 3)
        np.testing.assert_allclose(np.linalg.norm(arrows["vectors"], axis=2), NORMAL_M, rtol=1e-4)
    # outward: the pads of a gripper's two fingers face each other
    points, normals = (np.array(columns(chunks, f"/source/pads/{what}")[key])[0] for what, key in PADS)
    halves = np.split(points, 2)
    between = halves[1].mean(axis=0) - halves[0].mean(axis=0)
    assert (normals[:32] @ between > 0).all()
    assert (normals[32:] @ between < 0).all()
    camera = before.scene.cameras[0].name
    assert len(columns(chunks, f"/source/cameras/{camera}/depth")["frame"]) == len(after)
    assert f"/target/cameras/{camera}/depth" not in chunks
    K = np.array(columns(chunks, f"/target/cameras/{camera}", static=True)["image_from_camera"][0])
    np.testing.assert_allclose(K.reshape(3, 3).T, after.scene.cameras[0].K, rtol=1e-6)


PADS = (("points", "positions"), ("normals", "vectors"))


def test_joints_and_residuals_are_time_series(job: Path, episodes, chunks) -> None:
    _, after, entry = episodes
    body = load_embodiment(TARGET)
    for kind, values in (("position", after.qpos), ("action", after.action)):
        paths = [path for path in chunks if path.startswith(f"/target/joints/{kind}/")]
        assert len(paths) == len(body.joint_names)
        path = next(path for path in paths if path.split("/")[-1].startswith(body.joint_names[2]))
        np.testing.assert_array_equal(np.array(columns(chunks, path)["scalars"])[:, 0], values[:, 2])
    found = json.loads((job / "view.json").read_text())
    assert found["frames"] == len(after)
    for key, alignment in (("pad_distance_mm", "pad_distance_mm_mean"), ("normal_angle_deg", "normal_angle_deg_mean")):
        series = np.array(columns(chunks, f"/residuals/{key}")["scalars"])[:, 0]
        np.testing.assert_allclose(series, found["residuals"][key])
        assert series.mean() == pytest.approx(entry["alignment"][alignment], rel=1e-4)  # what cei-convert printed


def test_the_sheet_shows_both_robots_with_their_pads(job: Path) -> None:
    picture = np.asarray(Image.open(job / "view.png").convert("RGB")).astype(int)
    height, width, _ = picture.shape
    assert width > height > 1000
    r, g, b = np.moveaxis(picture, 2, 0)
    red, blue = np.minimum(r - g, r - b) > 80, np.minimum(b - r, b - g) > 80
    above, below = slice(100, height // 2 - 100), slice(height // 2, height - 300)
    assert blue[above].sum() > 1000  # pads of the source in its own row, none of the target's
    assert red[above].sum() == 0
    assert red[below].sum() > 500  # both in the target's row
    assert blue[below].sum() > 400
    grey = np.abs(picture - picture.mean(axis=2, keepdims=True)).max(axis=2) < 8
    assert (grey & (picture.mean(axis=2) < 200))[above].mean() > 0.1  # a robot


@pytest.fixture
def alone(tmp_path: Path) -> Path:
    """A dataset of one frame without clouds, depth or cameras."""
    body = load_embodiment(SOURCE)
    scene = Scene(np.eye(4), (), np.array([[-0.5, -0.5, 0.0], [0.9, 0.5, 1.2]]))
    root = tmp_path / "alone"
    with DatasetWriter("me/alone", root) as writer:
        writer.add(Demonstration(SOURCE, 20.0, body.home[None], body.home[None], scene, task="no $\\formula."))
    return root


def test_one_frame_without_clouds_is_shown_and_a_sheet_needs_no_rerun(
    alone: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cei_view.main([*dataset(alone), f"--rrd={tmp_path / 'a.rrd'}"]) == 0
    found = read_chunks(tmp_path / "a.rrd")
    assert columns(found, "/dataset/pads/points")["frame"] == [0]
    assert not [path for path in found if "cloud" in path or "camera" in path or "residual" in path]
    monkeypatch.setitem(sys.modules, "rerun", None)  # importing it fails
    assert cei_view.main([*dataset(alone), f"--sheet={tmp_path / 'new' / 'a.png'}"]) == 0
    assert len(np.unique(np.asarray(Image.open(tmp_path / "new" / "a.png")))) > 100


def test_clouds_of_any_size_and_with_colours_are_shown(alone: Path, tmp_path: Path) -> None:
    view = load_view(DatasetReader("me/alone", alone), 0)
    side = view.sides[0]
    rgb = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [2.0, -1.0, 0.0]])
    xyz = np.array([[0.3, 0.0, 0.3], [0.4, 0.1, 0.3], [np.nan, 0.0, 0.3]])
    cloud = np.concatenate([xyz, rgb], axis=1)[None].astype(np.float32)
    coloured = replace(side, demonstration=replace(side.demonstration, point_cloud_world=cloud))
    shown = View((coloured,), view.title, view.residuals)
    save(shown, tmp_path / "c.rrd")
    colours = columns(read_chunks(tmp_path / "c.rrd"), "/dataset/cloud")["colors"]
    assert [[c >> shift & 255 for shift in (24, 16, 8)] for c in colours[0]] == [
        [255, 0, 128],
        [0, 255, 0],
        [255, 0, 0],
    ]
    write_sheet(shown, tmp_path / "c.png")
    assert (np.asarray(Image.open(tmp_path / "c.png"))[..., :3] == (0, 255, 0)).all(axis=2).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--episode=7", "--rrd={new}.rrd"], "me/target has no episode 7. Valid: 0 to 0."),
        (["--sheet={new}.png", "--json={there}"], "already exists"),
        (["--sheet={there}"], "should end in .png"),
        (["--rrd={new}"], "should end in .rrd"),
        ([], "no display to open the viewer on; save --rrd=<file>.rrd or --sheet=<file>.png"),
        (["--dataset.root={new}", "--sheet={new}.png"], "no LeRobot dataset in"),
        (["--source.repo_id=me/alone", "--source.root={alone}", "--sheet={new}.png"], "is --source the dataset"),
        (["--json={there}/x.json", "--sheet={new}.png"], "view.rrd is no folder"),
    ],
)
def test_bad_input_gives_one_line_and_leaves_nothing(
    options: list[str],
    message: str,
    job: Path,
    alone: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    complaint: Callable,
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    before = sorted(tmp_path.rglob("*")), (job / "view.rrd").read_bytes()
    paths = {"new": tmp_path / "new", "there": job / "view.rrd", "alone": alone}
    filled = [option.format(**paths) for option in options]
    given = [] if any(option.startswith("--dataset.root") for option in filled) else dataset(job / "target")
    assert cei_view.main([*(given or ["--dataset.repo_id=me/target"]), *filled]) == 1
    assert message in complaint()
    assert (sorted(tmp_path.rglob("*")), (job / "view.rrd").read_bytes()) == before


def corrected(root: Path, frame: int, qpos: np.ndarray) -> None:
    """Have a dataset's first episode say that it is corrected."""
    (first, *others), path = Records(root), root / RECORDS_PATH
    figures = {"correction": {"closing_m": 0.006}, "frame": frame, "plain_qpos": qpos.tolist()}
    first["verified"] = {"corrected": figures, "plain_held": 0.25, "held": 1.0}
    path.write_text("".join(json.dumps(record) + "\n" for record in [first, *others]))


def test_a_correction_is_shown_without_and_with_it(
    job: Path, episodes, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    root = shutil.copytree(job / "target", tmp_path / "target")
    _, after, _ = episodes
    frame, body = len(after) // 2, load_embodiment(TARGET)
    without = after.qpos[frame].copy()
    without[0] += 0.05
    corrected(root, frame, without)
    files = [f"--rrd={tmp_path / 'c.rrd'}", f"--sheet={tmp_path / 'c.png'}", f"--json={tmp_path / 'c.json'}"]
    assert cei_view.main([*dataset(root), *beside(job / "source"), *files]) == 0
    said = "corrected: closing 6 mm; of replays slightly otherwise held 25% without, 100% with it"
    assert said in capsys.readouterr().out
    assert json.loads((tmp_path / "c.json").read_text())["correction"] == said
    found = read_chunks(tmp_path / "c.rrd")
    (words,) = columns(found, "/correction/words", static=True)["text"]
    assert words == [f"Frame {frame}: {said}."]
    pads = {
        role: np.array(columns(found, f"/correction/{role}/points", static=True)["positions"][0])
        for role in ("source", "uncorrected", "target")
    }
    T = link_poses(body, after.scene.T_world_base, np.array([without, after.qpos[frame]]))
    whose = load_view(DatasetReader("me/target", root), 0).sides[0].representation
    for role, pose in zip(("uncorrected", "target"), T, strict=True):
        np.testing.assert_allclose(pads[role], whose.place(pose[None])[0][0], atol=1e-5)
    moves = columns(found, "/correction/moves", static=True)
    np.testing.assert_allclose(moves["vectors"][0], pads["target"] - pads["uncorrected"], atol=1e-5)
    assert 0.01 < np.linalg.norm(moves["vectors"][0], axis=1).mean() < 0.1
    plain, more = (np.asarray(Image.open(path).convert("RGB")) for path in (job / "view.png", tmp_path / "c.png"))
    assert more.shape[0] > plain.shape[0] + 300
    amber = [((picture == (235, 150, 0)).all(axis=2)).sum() for picture in (plain, more)]
    assert amber[0] == 0 and amber[1] > 200


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"source_frames": [0, "1"]}, "source_frames should be"),
        ({"source_frames": None}, "source_frames should be"),
        ({"source_episode": 5}, "was converted from episode 5, which me/source does not have"),
        ({"source_episode": "../x"}, "was converted from episode ../x, which me/source does not have"),
        ({}, "no source_frames say which is which"),
    ],
)
def test_a_record_that_does_not_fit_the_source_is_refused(
    change: dict, message: str, job: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    root = shutil.copytree(job / "target", tmp_path / "target")
    (first, *others), path = Records(root), root / RECORDS_PATH
    del first["source_frames"]
    path.write_text("".join(json.dumps(record) + "\n" for record in [first | change, *others]))
    assert cei_view.main([*dataset(root), *beside(job / "source"), f"--sheet={tmp_path / 'x.png'}"]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "x.png").exists()


def test_points_are_hidden_by_what_stands_before_them_and_by_nearer_points() -> None:
    camera = look_at("c", (0, 0, 1), (0, 0, 0), 41, 41, 60.0, up=(0, 1, 0))
    picture, depth_m = np.zeros((41, 41, 3), np.uint8), np.zeros((41, 41))
    depth_m[:, :20] = 0.5  # a wall before the left half
    points = np.array([[-0.2, 0, 0], [-0.1, 0, 0.6], [0.2, 0, 0.1], [0.1, 0, 0.55], [0, 0, 2], [np.nan, 0, 0]])
    rgb = np.array([[9, 0, 0], [0, 9, 0], [0, 0, 9], [9, 9, 0], [0, 9, 9], [9, 0, 9]], np.uint8)
    splat(picture, depth_m, camera, points, rgb, 1)
    shown = {tuple(colour) for colour in picture.reshape(-1, 3).tolist()} - {(0, 0, 0)}
    assert shown == {(0, 9, 0), (9, 9, 0)}  # the third lies behind the fourth, the fifth behind the camera
    assert (picture == (9, 9, 0)).all(axis=2).sum() == 5
    ((row, column),), _ = project(points[3:4], camera)
    assert tuple(picture[row, column]) == (9, 9, 0)
