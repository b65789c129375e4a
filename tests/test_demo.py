"""`make demo`, small: it runs to its end, and its page has what it promises and is shown by a browser."""

import base64
import io
import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from test_documents import check_options

EPISODES = 2
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class Page(HTMLParser):
    """What a page shows: its tables as rows of texts, its pictures and videos as bytes, its preformatted text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[list[str]]] = []
        self.media: list[tuple[str, bytes]] = []
        self.open: list[str] = []
        self.preformatted = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        elif tag in ("img", "video"):
            kind, data = re.fullmatch(
                r"data:(\S+);base64,(\S+)", dict(attrs)["src"] or ""
            ).groups()  # nothing is fetched
            self.media.append((kind, base64.b64decode(data, validate=True)))
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self.open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.tables[-1][-1][-1] += data
        elif self.open and self.open[-1] == "pre":
            self.preformatted += data


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
def page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text())


def test_tables_say_what_replay_and_conversion_found(page: Page, folder: Path) -> None:
    successes, quality, physics = page.tables
    assert [row[:3] for row in successes[1:]] == [
        ["Panda-PandaGripper", "CEI-PickCube-Panda-PandaGripper", f"{EPISODES} of {EPISODES}"],
        ["IIWA-Inspire", "CEI-PickCube-IIWA-Inspire", f"{EPISODES} of {EPISODES}"],
    ]
    found = json.loads((folder / "conversion.json").read_text())
    assert len(quality) == EPISODES + 1
    for cells, entry in zip(quality[1:], found["results"], strict=True):
        row = dict(zip(quality[0], map(float, cells), strict=True))
        assert row["episode"] == entry["episode"]
        assert row["frames"] == entry["frames"]
        for name, key in (
            ("pad distance, mean (mm)", "pad_distance_mm_mean"),
            ("normal angle, mean (deg)", "normal_angle_deg_mean"),
            ("deepest penetration (mm)", "penetration_mm_max"),
            ("quality, 0 to 1", "quality"),
        ):
            assert row[name] == pytest.approx(entry[key], rel=0.005), name
        assert 0.7 < row["quality, 0 to 1"] <= 1
        assert row["pad distance, mean (mm)"] < 15
    assert {row[0] for row in physics[1:]} == {"Panda", "PandaGripper", "IIWA", "Inspire"}


def test_pictures_show_something_and_the_video_plays(page: Page) -> None:
    kinds = [kind for kind, _ in page.media]
    assert kinds == ["video/mp4", "image/png", "image/png", "image/png"]  # side by side, residuals, clouds
    with av.open(io.BytesIO(page.media[0][1])) as video:
        frames = [frame.to_ndarray(format="gray") for frame in video.decode(video=0)]
    assert len(frames) > 50
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 100  # the robots have moved
    for _, content in page.media[1:]:
        picture = np.asarray(Image.open(io.BytesIO(content)).convert("L"))
        assert min(picture.shape) > 200
        assert picture.std() > 10


def test_what_it_says_to_do_by_hand_are_commands_there_are(page: Page) -> None:
    commands = page.preformatted
    assert re.findall(r"^cei-\w+", commands, re.MULTILINE) == ["cei-record", "cei-convert", "cei-replay"]
    assert check_options(commands, "the report") == 3
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
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--hide-scrollbars"]
    options += [f"--user-data-dir={tmp_path / 'profile'}", "--window-size=1100,2600"]
    shot = tmp_path / "page.png"
    command = [str(CHROMIUM), *options, f"--screenshot={shot}", (folder / "report.html").resolve().as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    picture = np.asarray(Image.open(shot).convert("RGB")).astype(int)
    orange = (picture[..., 0] > 180) & (picture[..., 1] < 140) & (picture[..., 2] < 60)  # the IIWA
    assert orange.sum() > 2000
    assert (picture.min(axis=-1) < 250).any(axis=1).mean() > 0.5  # and something beside it, from top to bottom
