"""A camera, and by how much its pictures trail the joints, from outlines of robots: in pictures that are drawn, and in real ones."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from cei_gym.arrays import Array
from cei_gym.demonstration import Camera
from cei_gym.embodiment import load_embodiment
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
