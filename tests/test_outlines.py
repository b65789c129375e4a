"""A camera, and by how much its pictures trail the joints, from outlines of robots: in pictures that are drawn, and in real ones."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import ndimage
from scipy.spatial.transform import Rotation

from cei_converters import calibrate
from cei_converters.sources.calibration import load_calibration
from cei_converters.sources.clicks import load_clicks
from cei_converters.sources.formats import open_source
from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import catalogue, load_embodiment
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.painting import Footage, delayed, fit_outlines
from cei_gym.painting.light import Light
from cei_gym.painting.view import RobotView
from cei_gym.rendering import image_points, look_at

FPS, FRAMES, BASE = 30, 60, np.eye(4)
CAMERA = look_at("eye", (1.4, 0.5, 0.9), (0.2, 0.0, 0.45), 320, 240, 45.0)
PANDA = load_embodiment("Panda-PandaGripper")


def motion() -> Array:
    """(T, n) joints of an arm that is fast at times."""
    t = np.linspace(0, 2 * np.pi, FRAMES)
    arm = np.stack([0.5 * np.sin(t), 0.3 * np.sin(2 * t), 0.3 * np.cos(t), 0.3 * np.sin(t + 1)], axis=1)
    qpos = np.tile(PANDA.home, (FRAMES, 1))
    qpos[:, :4] += arm
    return qpos


def filmed(qpos: Array, beside: Sequence[str] = ()) -> Array:
    """(T, H, W, 3) pictures of robots before a wall with stains."""
    view = RobotView(PANDA, BASE, CAMERA, [load_embodiment(name) for name in beside])
    random, pictures = np.random.default_rng(0), []
    stains = ndimage.gaussian_filter(random.normal(size=(240, 320, 3)), (6, 6, 0)) * 1.5
    for q in qpos:
        drawn = view.draw(q, 2)
        picture = np.clip(0.35 + stains, 0, 1)
        colours, share, _ = Light.assumed().on(drawn, view.colours)
        picture[drawn.part] += share[..., None] * (colours - picture[drawn.part])
        pictures.append(picture + random.normal(scale=0.01, size=picture.shape))
    return np.stack(pictures).astype(np.float32)


def footage(qpos: Array, pictures: Array) -> Footage:
    few = np.arange(3, FRAMES, 4)
    return Footage(pictures[few], lambda lag_s: delayed(qpos, FPS * lag_s)[few])


def guessed(far_m: float, far_deg: float, focal: float) -> Camera:
    T, K = CAMERA.T_world_camera.copy(), CAMERA.K.copy()
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(np.radians(far_deg) * np.array([0.6, -0.7, 0.3])).as_matrix()
    T[:3, 3] += far_m * np.array([0.6, 0.6, -0.5])
    K[[0, 1], [0, 1]] *= focal
    return replace(CAMERA, T_world_camera=T, K=K)


def apart_px(camera: Camera, qpos: Array) -> float:
    points = KinematicTree(PANDA).forward(qpos)[..., :3, 3].reshape(-1, 3)
    off = image_points(points, camera)[0] - image_points(points, CAMERA)[0]
    return float(np.linalg.norm(off, axis=1).mean())


@pytest.mark.parametrize("lag_frames", [0, 3])
def test_a_camera_and_its_lag_are_found(lag_frames: int) -> None:
    qpos = motion()
    seen = footage(qpos, filmed(delayed(qpos, lag_frames)))
    guess = guessed(0.015, 1.2, 1.02)
    assert apart_px(guess, qpos) > 4
    found, met = fit_outlines([PANDA], BASE, guess, seen)
    assert found.camera.lag_s * FPS == pytest.approx(lag_frames, abs=0.3)
    assert apart_px(found.camera, qpos) < 1.0 and found.apart_px < 1.0
    assert met > 0.7


def test_what_pictures_do_not_show_is_refused() -> None:
    qpos = motion()
    pictures = filmed(qpos)
    elsewhere = footage(qpos[::-1], pictures)
    with pytest.raises(CEIError, match="no camera is found: "):
        fit_outlines([PANDA], BASE, guessed(0.06, 8.0, 0.9), elsewhere)
    with pytest.raises(CEIError, match="by 8 pictures or more, not 2"):
        fit_outlines([PANDA], BASE, CAMERA, Footage(pictures[:2], lambda _: qpos[:2]))


def test_other_robots_may_be_in_view() -> None:
    other = load_embodiment("IIWA-Inspire")
    own, still = motion(), other.home.copy()
    still[:1] += 1.5
    qpos = np.hstack([own, np.tile(still, (FRAMES, 1))])
    found, _ = fit_outlines([PANDA, other], BASE, guessed(0.015, 1.2, 1.02), footage(qpos, filmed(qpos, [other.name])))
    assert apart_px(found.camera, own) < 1.0


def test_joints_are_delayed_in_proportion() -> None:
    qpos = np.array([[0.0], [1.0], [4.0]])
    np.testing.assert_allclose(delayed(qpos, 0.5)[:, 0], [0.0, 0.5, 2.5])
    np.testing.assert_allclose(delayed(qpos, -1.0)[:, 0], [1.0, 4.0, 4.0])
    np.testing.assert_allclose(delayed(qpos[:1], 2.0), qpos[:1])


# a real one

SHARED = Path(__file__).parents[2] / "shared"
G1, G1_URDF = SHARED / "datasets/g1_inspire_pick_v2.1", SHARED / "robots/unitree_g1/g1_body29_hand14.urdf"
CLICKS = Path(__file__).parent / "g1_clicks.yaml"
needs_g1 = pytest.mark.skipif(not (G1.exists() and G1_URDF.exists()), reason="needs ../shared")
PARTS = ["shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw"]
FINGERS = [
    "pinky_proximal",
    "ring_proximal",
    "middle_proximal",
    "index_proximal",
    "thumb_proximal_2",
    "thumb_proximal_1",
]


def arm(side: str, other: str, roll: list[float]) -> dict[str, object]:
    return {
        "name": f"G1{side.title()}",
        "description": str(G1_URDF.resolve()),
        "root_body": "torso_link",
        "joints": [f"{side}_{part}_joint" for part in PARTS],
        "leave_out": ["head_link", f"{other}_shoulder_pitch_link"],
        "until_body": f"{side}_hand_palm_link",
        "mount_body": f"{side}_wrist_yaw_link",
        "mount_pos_m": [0.08, 0.0, 0.0],
        "mount_quat_wxyz": roll,
        "home": {f"{side}_elbow_joint": 0.5},
    }


def joint_map(side: str, embodiment: str, arm_at: int, hand_at: int) -> dict[str, object]:
    fingers = {
        "joints": [f"joint_{side}_{finger}" for finger in FINGERS],
        "columns": {"start": hand_at, "end": hand_at + 6},
        "unit": "normalised",
        "range": [1, 0],
    }
    joints = [{"joints": "arm", "columns": {"start": arm_at, "end": arm_at + 7}}, fingers]
    return {"embodiment": embodiment, "joints": joints, "ignore": "rest"}


@pytest.fixture
def g1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with both arms of a G1, Inspire hands on them, their joint maps, and the camera as its link in the description has it."""
    texts = {
        "arms/G1Right.yaml": arm("right", "left", [0.0, 0.70710678, 0.0, 0.70710678]),
        "arms/G1Left.yaml": arm("left", "right", [0.70710678, 0.0, 0.70710678, 0.0]),
        "right.yaml": joint_map("r", "G1Right-Inspire", 7, 20),
        "left.yaml": joint_map("l", "G1Left-InspireLeft", 0, 14),
    }
    c, s = np.cos(np.radians(47.6)), np.sin(np.radians(47.6))
    T = [[0.0, -s, c, 0.0576], [-1.0, 0.0, 0.0, 0.0175], [0.0, -c, -s, 0.4299], [0.0, 0.0, 0.0, 1.0]]
    K = {"fx": 610.0, "fy": 610.0, "cx": 319.5, "cy": 239.5}
    rough = {"width": 640, "height": 480, "K": K, "T_world_camera": np.array(T).tolist()}
    texts["rough.yaml"] = {"cameras": {"cam_high": rough}}
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(yaml.safe_dump(text))
    monkeypatch.setenv(catalogue.FOLDERS, str(tmp_path))
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "home"))
    return tmp_path


def calibrating(g1: Path, *options: str) -> int:
    return calibrate.main(
        [
            "--dataset.repo_id=lab/g1",
            f"--dataset.root={G1}",
            f"--joint_map={g1 / 'right.yaml'}",
            "--camera=cam_high",
            f"--calibration={g1 / 'rough.yaml'}",
            f"--output={g1 / 'cameras.yaml'}",
            *options,
        ]
    )


@needs_g1
def test_a_humanoids_head_camera_is_found_and_its_video_is_late(g1: Path) -> None:
    clicks = yaml.safe_load(CLICKS.read_text())
    (g1 / "clicks.yaml").write_text(yaml.safe_dump(clicks[::2]))
    (g1 / "held_out.yaml").write_text(yaml.safe_dump(clicks[1::2]))
    options = ["--by=outlines", f"--beside={g1 / 'left.yaml'}", f"--clicks={g1 / 'clicks.yaml'}", "--pictures=24"]
    assert calibrating(g1, *options, f"--json={g1 / 'r.json'}") == 0
    result = json.loads((g1 / "r.json").read_text())
    assert result["apart_px"] < 2
    (camera,) = load_calibration(g1 / "cameras.yaml").cameras
    assert camera.lag_s == pytest.approx(0.1, abs=0.03) == pytest.approx(result["lag_s"], abs=0.03)
    # Of another fit, of another program, to the same pictures.
    np.testing.assert_allclose(camera.T_world_camera[:3, 3], (0.047, 0.040, 0.441), atol=0.02)
    assert camera.K[0, 0] == pytest.approx(624, rel=0.03)
    sources = [open_source("lab/g1", G1, joint_map=g1 / name, joints_only=True) for name in ("right.yaml", "left.yaml")]
    robots = [source.embodiment for source in sources]
    view = RobotView(robots[0], BASE, camera, robots[1:])
    off_px = []
    for click in load_clicks(g1 / "held_out.yaml", robots, 640, 480):
        qpos = [delayed(s.read(click.episode, clouds=False).qpos, s.fps * camera.lag_s)[click.frame] for s in sources]
        T = view.poses(np.concatenate(qpos))[click.body]
        point = T[:3, :3] @ click.xyz_link + T[:3, 3]
        off_px.append(np.linalg.norm(image_points(point[None], camera)[0][0] - click.pixel))
    assert np.median(off_px) < 4


def test_other_robots_are_for_outlines(g1: Path, complaint: Callable[[], str]) -> None:
    assert calibrating(g1, f"--beside={g1 / 'left.yaml'}") != 0
    assert "--beside is for --by=outlines; give both" in complaint()
    assert calibrating(g1, "--by=guesswork") != 0
    assert "unknown way to find a camera (--by) 'guesswork'" in complaint()


@needs_g1
def test_what_is_left_out_of_an_arm_is_not_there(g1: Path) -> None:
    robot = load_embodiment("G1Right-Inspire")
    assert "torso_link" in robot.body_names and "d435_link" in robot.body_names
    assert not [name for name in robot.body_names if name.startswith(("left_", "head", "right_hand"))]
    spec = yaml.safe_load((g1 / "arms/G1Right.yaml").read_text()) | {"name": "G1Odd", "leave_out": ["hed_link"]}
    (g1 / "arms/G1Odd.yaml").write_text(yaml.safe_dump(spec))
    with pytest.raises(CEIError, match="unknown link in leave_out of G1Odd 'hed_link'"):
        load_embodiment("G1Odd-Inspire")
