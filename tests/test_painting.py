"""Pictures that show another robot, against the true ones: the target's own simulation, with joints and objects as they are."""

import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from conversions import records
from scipy.spatial.transform import Rotation

from cei_converters import calibrate, convert
from cei_converters.conversion.cameras import CameraOptions
from cei_converters.dataset import schema
from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.rollout import record_episode
from cei_converters.sources.calibration import load_calibration
from cei_converters.sources.reader import DatasetReader
from cei_converters.view.episode import load_view
from cei_converters.view.sheet import picture_strips
from cei_gym.demonstration import Camera, Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.embodiment.meshes import visual_geoms
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.painting import Painter, Plate, Shot, agreement
from cei_gym.painting.behind import Change, nearest_in_time
from cei_gym.painting.light import Light, surface_terms
from cei_gym.painting.view import RobotView
from cei_gym.rendering import DepthCamera, image_points, look_at, project

SOURCE, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
IMAGE, VIDEO = "observation.images.front", "observation.images.left"
WIDTH, HEIGHT = 200, 150
SEEDS = (0, 1)
OFF = {IMAGE: 10, VIDEO: 30}
"""Of 255: more differs. Videos are compressed twice."""


@dataclass(frozen=True)
class Recorded:
    """What was recorded in a simulation, and the dataset of it: joints and pictures alone."""

    demonstrations: list[Demonstration]
    root: Path
    calibration: Path


def calibration_of(cameras: tuple[Camera, ...], T_world_base: np.ndarray) -> dict[str, Any]:
    fields = {
        camera.name: {
            "width": camera.width,
            "height": camera.height,
            "K": camera.K.tolist(),
            "T_world_camera": camera.T_world_camera.tolist(),
        }
        for camera in cameras
    }
    return {"cameras": fields, "T_world_base": T_world_base.tolist()}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    names = [key.rpartition(".")[2] for key in (IMAGE, VIDEO)]
    size = {"image_width": WIDTH, "image_height": HEIGHT}
    env = open_environment(f"CEI-PickCube-{SOURCE}", cameras=names, colours=True, **size)
    demonstrations = [record_episode(env, seed, seed)[0] for seed in SEEDS]
    env.close()
    folder = tmp_path_factory.mktemp("recorded")
    joints = schema.joint_feature_names(load_embodiment(SOURCE))
    row = {"dtype": "float32", "shape": (len(joints),), "names": joints}
    shape, axes = (HEIGHT, WIDTH, 3), ["height", "width", "channels"]
    pictures = {
        key: {"dtype": kind, "shape": shape, "names": axes} for key, kind in ((IMAGE, "image"), (VIDEO, "video"))
    }
    features = {schema.STATE: row, schema.ACTION: row, **pictures}
    dataset = LeRobotDataset.create("me/pick", fps=20, features=features, root=folder / "pick", robot_type="panda")
    for demonstration in demonstrations:
        for t, (qpos, action) in enumerate(zip(demonstration.qpos, demonstration.action, strict=True)):
            shown = {key: demonstration.rgb[key.rpartition(".")[2]][t] for key in (IMAGE, VIDEO)}
            numbers = {schema.STATE: qpos.astype(np.float32), schema.ACTION: action.astype(np.float32)}
            dataset.add_frame({**numbers, **shown, "task": "pick"})
        dataset.save_episode()
    dataset.finalize()
    scene = demonstrations[0].scene
    (folder / "cameras.yaml").write_text(yaml.safe_dump(calibration_of(scene.cameras, scene.T_world_base)))
    return Recorded(demonstrations, folder / "pick", folder / "cameras.yaml")


def run(recorded: Recorded, out: Path, *options: str) -> int:
    return convert.main(
        [
            "--dataset.repo_id=me/pick",
            f"--dataset.root={recorded.root}",
            f"--source={SOURCE}",
            f"--target={TARGET}",
            "--table_z_m=0.8",
            "--new_repo_id=me/out",
            f"--new_root={out}",
            "--init.starts=8",
            "--init.basins=1",
            *options,
        ]
    )


@pytest.fixture(scope="module")
def painted(recorded: Recorded, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("painted") / "out"
    options = (f"--calibration={recorded.calibration}", "--cameras.paint", "--workers=2", "--shard_episodes=1")
    assert run(recorded, out, *options, f"--json={out.parent / 'result.json'}") == 0
    return out


@pytest.fixture(scope="module")
def true(recorded: Recorded, painted: Path) -> dict[str, list[np.ndarray]]:
    """What the target's own simulation shows at the joints of the painted dataset, with objects where they were."""
    names = [key.rpartition(".")[2] for key in (IMAGE, VIDEO)]
    env = open_environment(
        f"CEI-PickCube-{TARGET}", cameras=names, colours=True, image_width=WIDTH, image_height=HEIGHT
    )
    reader, found = DatasetReader("me/out", painted), {IMAGE: list[np.ndarray](), VIDEO: list[np.ndarray]()}
    for index, demonstration in enumerate(recorded.demonstrations):
        qpos = reader.read(index, clouds=False).qpos
        state = demonstration.environment_state
        assert state is not None
        frames = records(painted)[index].get("source_frames", range(len(qpos)))
        shown: dict[str, list[np.ndarray]] = {key: [] for key in found}
        for q, t in zip(qpos, frames, strict=True):
            env.reset(seed=0, options={"agent_pos": q, "environment_state": state[t]})
            for key in found:
                shown[key].append(env.unwrapped.rgb()[key.rpartition(".")[2]])  # pyright: ignore
        for key, each in shown.items():
            found[key].append(np.stack(each))
    env.close()
    return found


# the whole way


def masks(demonstration: Demonstration, qpos: np.ndarray, frames: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(T, H, W) each: where the source was, and where the target is."""
    scene = demonstration.scene
    camera = next(camera for camera in scene.cameras if camera.name == name)
    views = [RobotView(load_embodiment(robot), scene.T_world_base, camera) for robot in (SOURCE, TARGET)]
    was = np.stack([views[0].silhouette(demonstration.qpos[t]) for t in frames])
    return was, np.stack([views[1].silhouette(q) for q in qpos])


@pytest.mark.parametrize("key", [IMAGE, VIDEO])
def test_painted_pictures_are_nearly_the_true_ones(
    key: str, recorded: Recorded, painted: Path, true: dict[str, list[np.ndarray]]
) -> None:
    reader, off = DatasetReader("me/out", painted), dict[str, list[np.ndarray]]()
    for index, demonstration in enumerate(recorded.demonstrations):
        qpos, shown = reader.read(index, clouds=False).qpos, reader.pictures(index).decode(key)
        frames = records(painted)[index].get("source_frames", range(len(qpos)))
        was, is_ = masks(demonstration, qpos, frames, key.rpartition(".")[2])
        wrong = np.abs(shown.astype(int) - true[key][index]).max(axis=-1) > OFF[key]
        left = np.abs(demonstration.rgb[key.rpartition(".")[2]][frames].astype(int) - true[key][index]).max(axis=-1)
        parts = {"whole": wrong, "uncovered": wrong[was & ~is_], "robot": wrong[is_], "left in": left > OFF[key]}
        for name, part in parts.items():
            off.setdefault(name, []).append(part.ravel())
    share = {name: float(np.concatenate(each).mean()) for name, each in off.items()}
    assert share["whole"] < 0.006
    assert share["uncovered"] < 0.06
    assert share["robot"] < 0.06
    assert share["left in"] > 20 * share["whole"]


def test_what_was_carried_is_still_there(recorded: Recorded, painted: Path, true: dict[str, list[np.ndarray]]) -> None:
    reader = DatasetReader("me/out", painted)
    seen = there = 0
    for index in range(len(recorded.demonstrations)):
        shown, real = reader.pictures(index).decode(IMAGE).astype(int), true[IMAGE][index].astype(int)
        red = [(each[..., 0] > 100) & (each[..., 1] < 70) & (each[..., 2] < 70) for each in (shown, real)]
        lifted = slice(len(shown) - 10, None)
        seen += int(red[1][lifted].sum())
        there += int((red[0] & red[1])[lifted].sum())
    assert seen > 200 and there > 0.7 * seen


def test_videos_are_what_they_were_and_statistics_are_new(recorded: Recorded, painted: Path) -> None:
    before, after = (json.loads((root / "meta/info.json").read_text()) for root in (recorded.root, painted))
    for key in (IMAGE, VIDEO):
        assert after["features"][key]["shape"] == before["features"][key]["shape"]
        assert after["features"][key]["dtype"] == before["features"][key]["dtype"]
    reader = DatasetReader("me/out", painted)
    pictures = reader.pictures(0)
    mean = pictures.decode(IMAGE).mean(axis=(0, 1, 2)) / 255
    np.testing.assert_allclose(np.ravel(pictures.statistics[IMAGE]["mean"]), mean, atol=0.02)
    for index in range(len(SEEDS)):
        assert len(reader.pictures(index).decode(VIDEO)) == reader.frames(index)


def test_card_records_and_result_say_how(painted: Path) -> None:
    for record in records(painted):
        assert record["painted"] == [IMAGE, VIDEO]
        assert record["painting"][IMAGE]["cut_out"] == record["painting"][IMAGE]["carried"] == 1
        assert 0 < record["painting"][IMAGE]["light_off"] < 5
    card = " ".join((painted / "README.md").read_text().split())
    assert f"In 2 of 2 episodes pictures of `{IMAGE}` were painted, by geometry" in card
    assert "Shadows that the source throws stay" in card
    assert "they still show" not in card
    result = json.loads((painted.parent / "result.json").read_text())
    assert result["passed_through"] == [] and result["painted"][IMAGE]["explained"] > 0.85


def test_the_sheet_shows_them_beside_the_recorded_ones(recorded: Recorded, painted: Path) -> None:
    reader, source = DatasetReader("me/out", painted), DatasetReader("me/pick", recorded.root, embodiment=SOURCE)
    view = load_view(reader, 0, source, pictures=True)
    moments = np.array([0, len(view) - 1])
    strips = dict(picture_strips(view, moments))
    assert len(strips) == 6
    shown = strips[f"front\ntarget: {TARGET}"]
    np.testing.assert_array_equal(shown, reader.pictures(0).decode(IMAGE)[moments])
    was = strips[f"front\nsource: {SOURCE}"]
    np.testing.assert_array_equal(strips["front\ndifference"], np.abs(was.astype(int) - shown))
    assert not load_view(reader, 0, source).sides[0].pictures


def test_pictures_are_the_same_whoever_paints(recorded: Recorded, painted: Path, tmp_path: Path) -> None:
    options = (f"--calibration={recorded.calibration}", "--cameras.paint", "--workers=1")
    assert run(recorded, tmp_path / "again", *options) == 0
    one, other = (DatasetReader("me/out", root) for root in (painted, tmp_path / "again"))
    for index in range(len(SEEDS)):
        assert one.pictures(index).images[IMAGE].equals(other.pictures(index).images[IMAGE])
        np.testing.assert_array_equal(*(each.pictures(index).decode(VIDEO) for each in (one, other)))


# where the camera is


def guessed(camera: Camera, seed: int, far_m: float, far_deg: float, focal: float) -> Camera:
    """A camera off by so much, in a direction drawn."""
    random = np.random.default_rng(seed)
    shift, axis = (each / np.linalg.norm(each) for each in random.normal(size=(2, 3)))
    T, K = camera.T_world_camera.copy(), camera.K.copy()
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(np.radians(far_deg) * axis).as_matrix()
    T[:3, 3] += far_m * shift
    K[[0, 1], [0, 1]] *= focal
    return replace(camera, T_world_camera=T, K=K)


def calibrating(recorded: Recorded, guess: Camera, folder: Path, *options: str) -> int:
    scene = recorded.demonstrations[0].scene
    (folder / "rough.yaml").write_text(yaml.safe_dump(calibration_of((guess,), scene.T_world_base)))
    return calibrate.main(
        [
            "--dataset.repo_id=me/pick",
            f"--dataset.root={recorded.root}",
            f"--source={SOURCE}",
            "--camera=front",
            f"--calibration={folder / 'rough.yaml'}",
            f"--output={folder / 'cameras.yaml'}",
            *options,
        ]
    )


def apart_px(recorded: Recorded, one: Camera, other: Camera) -> float:
    """Mean distance between where two cameras see the robot."""
    body, scene = load_embodiment(SOURCE), recorded.demonstrations[0].scene
    T = scene.T_world_base @ KinematicTree(body).forward(recorded.demonstrations[0].qpos)
    points = T[..., :3, 3].reshape(-1, 3)
    (a, _), (b, _) = (project(points, replace(camera, width=4000, height=4000)) for camera in (one, other))
    return float(np.linalg.norm(a - b, axis=1).mean())


def test_a_camera_is_found_from_joints_and_pictures(
    recorded: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    true = recorded.demonstrations[0].scene.cameras[0]
    guess = guessed(true, 0, 0.03, 3.0, 0.95)
    sheet, json_path = tmp_path / "sheet.png", tmp_path / "r.json"
    asked = ("--pictures=12", f"--sheet={sheet}", f"--json={json_path}")
    assert calibrating(recorded, guess, tmp_path, *asked) == 0
    assert "Two halves of the pictures agree within" in capsys.readouterr().out
    found = load_calibration(tmp_path / "cameras.yaml")
    (camera,) = found.cameras
    assert apart_px(recorded, guess, true) > 4
    assert apart_px(recorded, camera, true) < 1.0  # rounded to whole pixels
    result = json.loads(json_path.read_text())
    assert result["apart_px"] < 1.5 and result["explained"] > 0.85 and result["moved_px"] > 4
    assert sheet.read_bytes().startswith(b"\x89PNG")
    np.testing.assert_allclose(found.T_world_base, recorded.demonstrations[0].scene.T_world_base)


def test_a_camera_is_found_from_clicks_without_a_pose(
    recorded: Recorded, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    scene, body = recorded.demonstrations[0].scene, load_embodiment(SOURCE)
    true, clicks = scene.cameras[0], []
    random = np.random.default_rng(0)
    for frame, link in itertools.product((0, 20, 40), ("link2", "link3", "link5", "link6", "link7", "right_gripper")):
        T_base_links = KinematicTree(body).forward(recorded.demonstrations[0].qpos[frame])
        point = (scene.T_world_base @ T_base_links[body.body_id(link)])[:3, 3]
        pixel = image_points(point[None], true)[0][0] + random.normal(size=2)
        if not ((pixel > 0) & (pixel < (WIDTH - 1, HEIGHT - 1))).all():
            continue
        clicks.append({"episode": 0, "frame": frame, "point": link, "pixel": pixel.tolist()})
    (tmp_path / "clicks.yaml").write_text(yaml.safe_dump(clicks))
    nowhere = replace(true, T_world_camera=np.eye(4))
    asked = (f"--clicks={tmp_path / 'clicks.yaml'}", "--pictures=8")
    assert calibrating(recorded, nowhere, tmp_path, *asked) == 0
    (camera,) = load_calibration(tmp_path / "cameras.yaml").cameras
    assert apart_px(recorded, camera, true) < 1.5
    clicks[0]["frame"] = 9999
    (tmp_path / "clicks.yaml").write_text(yaml.safe_dump(clicks))
    assert calibrating(recorded, nowhere, tmp_path, *asked, "--overwrite") == 1
    assert "clicks.yaml: click 1: frame 9999 is none of the" in complaint()


def test_a_camera_that_cannot_be_found_is_refused(
    recorded: Recorded, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    true = recorded.demonstrations[0].scene.cameras[0]
    assert calibrating(recorded, guessed(true, 1, 0.3, 25.0, 1.2), tmp_path, "--pictures=8") == 1
    assert "no camera is found" in complaint()
    assert not (tmp_path / "cameras.yaml").exists()
    assert calibrating(recorded, away(true), tmp_path) == 1
    assert "is not in the view of camera 'front' by the guess" in complaint()


# which cameras


@pytest.mark.parametrize(("keep", "kept"), [("left", [VIDEO]), (IMAGE, [IMAGE]), ("none", [])])
def test_cameras_can_be_left_out(keep: str, kept: list[str], recorded: Recorded, tmp_path: Path) -> None:
    assert run(recorded, tmp_path / "out", f"--cameras.keep={keep}", f"--json={tmp_path / 'r.json'}") == 0
    reader = DatasetReader("me/out", tmp_path / "out")
    assert list(reader.cameras) == kept
    dropped = json.loads((tmp_path / "r.json").read_text())["dropped_features"]
    assert {key for key, why in dropped.items() if why == "by --cameras.keep"} == {IMAGE, VIDEO} - {*kept}


def test_a_missing_video_blocks_only_who_wants_it(
    recorded: Recorded, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    import shutil

    root = tmp_path / "pick"
    shutil.copytree(recorded.root, root)
    for path in (root / "videos").rglob("*.mp4"):
        path.unlink()
    without = replace(recorded, root=root)
    assert run(without, tmp_path / "no") == 1
    assert "is missing; download the dataset with its videos" in complaint()
    assert run(without, tmp_path / "out", "--cameras.keep=front") == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--cameras.keep=frnt"], "unknown camera with pictures 'frnt'"),
        (["--cameras.paint"], "has no calibration (no camera has)"),
        (["--cameras.paint", "--cameras.keep=none"], "--cameras.keep=none leaves nothing for --cameras.paint"),
        (["--cameras.margin_px=3"], "--cameras.margin_px"),
        (["--cameras.paint", "--cameras.margin_px=-1"], "--cameras.margin_px=-1.0 should be at least 0"),
        (["--cameras.paint", "--augment.grid=2,2", "--augment.range=0.1,0.1"], "leave out --cameras.paint"),
    ],
)
def test_bad_options(
    options: list[str], said: str, recorded: Recorded, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    assert run(recorded, tmp_path / "out", *options) != 0
    assert said in complaint()
    assert not (tmp_path / "out").exists()


def turned(camera: Camera) -> Camera:
    T = camera.T_world_camera.copy()
    T[:3, :3] = Rotation.from_euler("z", 20, degrees=True).as_matrix() @ T[:3, :3]
    return replace(camera, T_world_camera=T)


def away(camera: Camera) -> Camera:
    T = camera.T_world_camera.copy()
    T[:3, :3] = T[:3, :3] @ Rotation.from_euler("y", 180, degrees=True).as_matrix()
    return replace(camera, T_world_camera=T)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (turned, "so that its calibration (or the joints, or the base's pose) is wrong; nothing is painted by it"),
        (away, "is not in the pictures of observation.images.front by its calibration and joints"),
        (lambda camera: replace(camera, width=2 * WIDTH), "but 'front' is calibrated for 400x150"),
    ],
)
def test_wrong_calibrations_are_refused(
    edit: Callable[[Camera], Camera],
    said: str,
    recorded: Recorded,
    tmp_path: Path,
    complaint: Callable[[], str],
) -> None:
    scene = recorded.demonstrations[0].scene
    path = tmp_path / "cameras.yaml"
    path.write_text(yaml.safe_dump(calibration_of((edit(scene.cameras[0]),), scene.T_world_base)))
    options = (f"--calibration={path}", "--cameras.paint", "--cameras.keep=front")
    assert run(recorded, tmp_path / "out", *options) == 1
    assert said in complaint()
    assert not (tmp_path / "out").exists()


def test_a_camera_that_moves_agrees_with_nothing(recorded: Recorded) -> None:
    demonstration = recorded.demonstrations[0]
    scene, few = demonstration.scene, np.arange(0, len(demonstration), 5)
    robot = load_embodiment(SOURCE)
    painter = Painter(robot, robot, scene.T_world_base, scene.T_world_base, scene.cameras[0])
    covered = painter.covered(demonstration.qpos[few])
    still = demonstration.rgb["front"][few]
    moving = np.stack([np.roll(picture, 11 * i, axis=1) for i, picture in enumerate(still)])
    found = [agreement(each, covered, Plate.median(each, covered)) for each in (still, moving)]
    assert found[0].still > 0.98 > 0.85 > found[1].still


def test_options_name_cameras_by_key_or_by_its_end() -> None:
    keys = [IMAGE, VIDEO]
    assert CameraOptions().kept(keys) == keys
    assert CameraOptions(keep="[left, front]").kept(keys) == keys
    with pytest.raises(CEIError, match=r"front, left.*none"):
        CameraOptions(keep="wrist").kept(keys)


# its parts


def brute_force(
    size: int, robot: list[np.ndarray], covered: list[np.ndarray], changes: list[Change]
) -> list[np.ndarray]:
    frames, found = range(len(robot)), []
    hidden = np.zeros((len(robot), size), bool)
    for t in frames:
        hidden[t, covered[t]] = True
    for t in frames:
        best = []
        for pixel in robot[t]:
            may = [s for s in frames if not hidden[s, pixel]]
            for change in changes:
                if pixel in change.pixels:
                    may = [s for s in may if (s < change.frame) == (t < change.frame)]
            best.append(min(may, key=lambda s: (abs(s - t), s), default=-1))
        found.append(np.array(best, int))
    return found


@pytest.mark.parametrize("seed", range(5))
def test_what_is_behind_is_taken_from_the_nearest_frame_that_shows_it_unchanged(seed: int) -> None:
    random, size, frames = np.random.default_rng(seed), 40, 12
    robot = [np.flatnonzero(random.random(size) < 0.6) for _ in range(frames)]
    covered = [np.union1d(pixels, np.flatnonzero(random.random(size) < 0.2)) for pixels in robot]
    changes = [Change(int(frame), np.flatnonzero(random.random(size) < 0.5)) for frame in random.integers(1, 12, 2)]
    found = nearest_in_time(size, robot, covered, changes)
    for one, other in zip(found, brute_force(size, robot, covered, changes), strict=True):
        np.testing.assert_array_equal(one, other)


CAMERA = look_at("eye", (1.4, 0.5, 0.9), (0.2, 0.0, 0.4), 160, 120, 50.0)


def view_of(robot: str) -> tuple[RobotView, np.ndarray]:
    body = load_embodiment(robot)
    return RobotView(body, np.eye(4), CAMERA), body.home


def test_a_robot_is_drawn_where_the_depth_camera_sees_it() -> None:
    body = load_embodiment(TARGET)
    camera = DepthCamera(body.model, (CAMERA,), geoms=visual_geoms(body.model))
    view = RobotView(body, np.eye(4), CAMERA)
    for fold in (0.0, 0.5, 1.0):
        qpos = body.home + fold * (body.closed - body.home)
        _, ids = camera.render_at(KinematicTree(body).forward(qpos))["eye"]
        np.testing.assert_array_equal(view.silhouette(qpos), ids >= 0)


def test_light_is_found_and_thrown_on_another_robot() -> None:
    weights = np.random.default_rng(1).normal(scale=0.06, size=(2, 10, 3))
    weights[0, 0] += 0.5
    light = Light(weights, 0.0)
    view, qpos = view_of(SOURCE)
    drawn = view.draw(qpos)
    terms, known = surface_terms(drawn)
    shown, _, _ = light.on(drawn, view.colours)
    inside = known & (shown > 0).all(axis=-1) & (shown < 1).all(axis=-1)
    pixels = shown[inside].copy()
    pixels[::10] = np.random.default_rng(2).random((len(pixels[::10]), 3))  # stickers, or a hand before it
    found = Light.fit(view.colours[drawn.geom_id[inside]], terms[inside], pixels)
    assert found.off < 0.02
    other, at = view_of("UR5e-FourierRight")
    one, another = (each.on(other.draw(at), other.colours)[0] for each in (light, found))
    assert np.median(np.abs(one - another)[one > 0]) < 0.03


def test_where_nothing_shows_the_light_it_is_assumed() -> None:
    assert np.isnan(Light.fit(np.ones((3, 3)), np.ones((3, 10)), np.ones((3, 3))).off)


def test_smooth_edges_are_painted_where_edges_were_smooth() -> None:
    view, qpos = view_of(SOURCE)
    base = np.eye(4)
    for finer in (1, 2):
        colours, share, _ = Light.assumed().on(view.draw(qpos, finer), view.colours)
        picture = np.full((120, 160, 3), 90.0)
        part = view.draw(qpos, finer).part
        picture[part] += share[..., None] * (255 * colours - picture[part])
        shot = Shot(np.rint(picture)[None].astype(np.uint8).repeat(2, axis=0), np.stack([qpos, qpos]))
        robot = load_embodiment(SOURCE)
        again, _ = Painter(robot, robot, base, base, CAMERA)(shot, np.arange(1), qpos[None])
        assert np.mean(np.abs(again[0].astype(float) - shot.pictures[0]).max(axis=-1) > 10) < 0.004
