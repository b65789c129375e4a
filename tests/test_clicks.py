"""A camera from clicks: what is solved from them, and which files are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cei_converters.sources.clicks import load_clicks
from cei_gym.demonstration import Camera
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.painting.clicks import Clicks
from cei_gym.rendering import image_points, look_at

GOOD = "- {episode: 0, frame: 1, point: link5, pixel: [20, 30]}\n"


def scene() -> tuple[Camera, np.ndarray]:
    robot = load_embodiment("Panda-PandaGripper")
    points_world = KinematicTree(robot).forward(robot.home)[[3, 5, 6, 8, 9, 10], :3, 3]
    camera = look_at("front", [1.4, 0.5, 1.1], [0.2, 0.0, 0.4], width=640, height=480, fovy_deg=45.0)
    return camera, points_world


@pytest.mark.parametrize(("noise_px", "focal"), [(0.0, 1.0), (2.0, 1.0), (0.0, 1.08)])
def test_a_camera_is_solved_from_clicks_wherever_the_guess_is(noise_px: float, focal: float) -> None:
    camera, points = scene()
    pixels = image_points(points, camera)[0] + np.random.default_rng(0).normal(scale=noise_px, size=(len(points), 2))
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= focal
    found = Clicks(points, pixels).camera(replace(camera, K=K, T_world_camera=np.eye(4)))
    off_px = np.linalg.norm(image_points(points, found)[0] - image_points(points, camera)[0], axis=1)
    assert off_px.mean() < 0.5 + noise_px * 1.5


def test_clicks_that_tell_no_camera_are_refused() -> None:
    camera, points = scene()
    pixels = image_points(points, camera)[0]
    with pytest.raises(CEIError, match=r"by 4 clicks or more, not 3"):
        Clicks(points[:3], pixels[:3]).camera(camera)
    line = np.linspace([0.0, 0, 0.2], [0.3, 0, 0.5], 5)
    with pytest.raises(CEIError, match=r"on one line"):
        Clicks(line, image_points(line, camera)[0]).camera(camera)
    with pytest.raises(CEIError, match=r"contradict each other.*number"):
        Clicks(points, pixels + 200 * np.eye(len(points), 2)).camera(camera)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (GOOD * 3, "a list of 4 to 1000 clicks"),
        ("{}", "a list of 4 to 1000 clicks"),
        (GOOD * 3 + "- {episode: 0, frame: 1, point: link5}", "click 4 should have episode, frame, point, pixel"),
        (GOOD * 4 + GOOD.replace("link5", "lnk5"), "click 5: unknown link of Panda-PandaGripper 'lnk5'. Did you mean"),
        (GOOD * 4 + GOOD.replace("1,", "-1,", 1), "click 5: frame should be a whole number from 0, not -1"),
        (GOOD * 4 + GOOD.replace("1,", "true,", 1), "click 5: frame should be a whole number from 0, not True"),
        (GOOD * 4 + GOOD.replace("20", "700"), "outside pictures of 640x480"),
        (GOOD * 4 + GOOD.replace("20", ".nan"), "click 5: pixel should be 2 numbers, not nan at 0"),
        (GOOD * 4 + GOOD.replace("link5", "{link: link5, xyz: [1, 2]}"), "click 5: xyz should be 3 numbers"),
        (GOOD * 4 + GOOD.replace("link5", "[1, 2, 3]"), "point should be a link's name, or link and xyz"),
        ("[" * 3, "cannot be read"),
    ],
)
def test_files_of_clicks_that_are_wrong_are_refused(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "clicks.yaml"
    path.write_text(text)
    with pytest.raises(CEIError) as error:
        load_clicks(path, [load_embodiment("Panda-PandaGripper")], 640, 480)
    assert says in str(error.value) and "\n" not in str(error.value)


def test_a_file_of_clicks_is_read(tmp_path: Path) -> None:
    path = tmp_path / "clicks.yaml"
    path.write_text(GOOD * 4 + GOOD.replace("link5", "{link: link5, xyz: [0.1, 0, 0.2]}"))
    clicks = load_clicks(path, [load_embodiment("Panda-PandaGripper")], 640, 480)
    np.testing.assert_allclose(clicks[4].xyz_link, (0.1, 0, 0.2))
    assert clicks[0].body == clicks[4].body and clicks[0].pixel.tolist() == [20, 30]
