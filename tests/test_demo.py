"""`make demo`, small: it runs to its end, and its page has what it promises and is shown by a browser."""

import io
import json
import re
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest
from browser import CHROMIUM
from pages import Html, screenshot
from PIL import Image
from test_documents import check_options

from cei_converters.dataset.records import Records

EPISODES = 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the demo leaves, run as the Makefile does."""
    folder = tmp_path_factory.mktemp("demo")
    command = [sys.executable, "-m", "cei_converters.start", "demo", f"--episodes={EPISODES}", "--seed=3"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (
        f"Open outputs/demo/report.html: {EPISODES} of {EPISODES} transferred demonstrations lift the cube."
        in done.stdout
    )
    return folder / "outputs/demo"


@pytest.fixture(scope="module")
def page(folder: Path) -> Html:
    return Html((folder / "report.html").read_text())


def test_tables_say_what_replay_and_conversion_found(page: Html, folder: Path) -> None:
    assert [[*row.values()][:3] for row in page.rows("robot")] == [
        ["Panda-PandaGripper", "CEI-PickCube-Panda-PandaGripper", f"{EPISODES} of {EPISODES}"],
        ["IIWA-Inspire", "CEI-PickCube-IIWA-Inspire", f"{EPISODES} of {EPISODES}"],
    ]
    found = json.loads((folder / "conversion.json").read_text())
    rows = page.rows("episode")
    assert len(rows) == EPISODES
    for row, entry in zip(rows, found["results"], strict=True):
        assert row["replay"] == "success"
        for name, key, digit in (
            ("episode", "episode", 0),
            ("frames", "frames", 0),
            ("pads (mm)", "pad_distance_mm_mean", 1),
            ("normals (deg)", "normal_angle_deg_mean", 1),
            ("depth (mm)", "penetration_mm_max", 1),
            ("fidelity", "fidelity", 2),
        ):
            assert float(row[name]) == pytest.approx(entry[key], abs=0.51 * 0.1**digit), name
        assert 0.7 < float(row["fidelity"]) <= 1
        assert float(row["pads (mm)"]) < 15
    assert {row["of"] for row in page.rows("of")} == {"Panda", "PandaGripper", "IIWA", "Inspire"}


def test_pictures_show_something_and_the_videos_play(page: Html) -> None:
    kinds = [kind for kind, _ in page.media]
    # two episodes side by side, residuals, both in pictures, clouds
    assert kinds == ["video/mp4"] * 2 + ["image/png"] + ["image/webp"] * 2 + ["image/png"]
    for _, content in page.media[:2]:
        with av.open(io.BytesIO(content)) as video:
            frames = [frame.to_ndarray(format="gray") for frame in video.decode(video=0)]
        assert len(frames) > 50
        assert np.abs(frames[0].astype(int) - frames[-1]).max() > 100  # the robots have moved
    for _, content in page.media[2:]:
        picture = np.asarray(Image.open(io.BytesIO(content)).convert("L"))
        assert min(picture.shape) > 200
        assert picture.std() > 10


def test_the_worst_is_told_first_and_why(page: Html, folder: Path) -> None:
    scores = [record["fidelity"]["score"] for record in Records(folder / "pick_cube_iiwa")]
    worst, best = np.argsort(scores)
    assert page.text.index(f"Episode {worst}, fidelity {min(scores):.2f}") < page.text.index(
        f"Episode {best}, fidelity {max(scores):.2f}, the best"
    )
    assert f"Its fidelity is {min(scores):.2f}, for its residual: how far its pads stay" in page.text


def test_what_it_says_to_do_by_hand_are_commands_there_are(page: Html) -> None:
    commands = page.preformatted
    names = ["cei-record", "cei-convert", "cei-replay", "cei-replay", "cei-report"]
    assert re.findall(r"^cei-\w+", commands, re.MULTILINE) == names
    assert check_options(commands, "the report") == 5
    assert max(map(len, commands.splitlines())) < 130


def test_another_folder_is_not_made_anew(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.txt").write_text("years")
    command = [sys.executable, "-m", "cei_converters.start", "demo", "--output=mine"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "no demo made it" in done.stderr
    assert (tmp_path / "mine/thesis.txt").read_text() == "years"


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_browser_shows_it(folder: Path, tmp_path: Path) -> None:
    picture = screenshot(folder / "report.html", tmp_path / "page.png").astype(int)
    orange = (picture[..., 0] > 150) & (picture[..., 0] - picture[..., 2] > 80)  # the IIWA, in films and drawings
    assert orange.sum() > 1000
    assert (picture.min(axis=-1) < 250).any(axis=1).mean() > 0.5  # and something beside it, from top to bottom
