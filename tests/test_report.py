"""`cei-report`: what its page says of a conversion and of replays, what it says is not known, whose files it refuses, and that a stranger's text stays text."""

import io
import json
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import av
import killed
import numpy as np
import pytest
from browser import CHROMIUM, browse
from pages import Html
from PIL import Image

from cei_converters import convert
from cei_converters import report as cei_report
from cei_converters.dataset.metadata import METADATA_PATH
from cei_converters.dataset.records import RECORDS_PATH, Records
from cei_converters.report.episodes import Episode, Twin
from cei_converters.report.page import render
from cei_converters.report.replays import Replayed
from cei_converters.report.summary import MOST, Summary
from cei_converters.sources.reader import DatasetReader
from cei_gym.alignment.contact.correction import Correction
from cei_gym.twin import Evidence

ROBOT, EPISODES, CORRECTED = "UR5e-PandaGripper", 3, 1
CORRECTION = Correction(closing_m=0.006, squeeze=1.3)
BAD = "<script>document.title='owned'</script><img src=x onerror=alert(1)>{{ 7 * 7 }}&amp;\"'"
"""What a stranger may write where text is expected."""


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recorded dataset, `pick`, the same converted, `out`, of which one episode has a correction, and results of replays."""
    folder = tmp_path_factory.mktemp("job")
    killed.write_source(folder / "pick")
    options = [f"--episodes=0-{EPISODES - 1}", "--shard_episodes=3"]
    assert convert.main(killed.arguments(folder / "pick", folder / "out", *options)) == 0
    change(folder / "out", CORRECTED, verified=verified(folder / "out"))
    write_replay(
        folder / "replay.json", "me/out", ROBOT, {0: "", 1: "", 2: "slipped"}, {0: [True, True], 1: [True, False]}
    )
    write_replay(folder / "source.json", "me/pick", killed.ROBOT, {0: "", 1: ""})
    return folder


def verified(root: Path) -> dict[str, Any]:
    qpos = DatasetReader("me/out", root).read(CORRECTED, clouds=False).qpos[2]
    corrected = {"correction": asdict(CORRECTION), "frame": 2, "plain_qpos": (qpos + 0.02).tolist()}
    said = {"success": True, "attempts": 7, "how": f"corrected ({CORRECTION})", "failure": "dropped"}
    return {**said, "plain_held": 0.2, "held": 1.0, "replays": 30, "corrected": corrected}


def change(root: Path, index: int, **values: Any) -> None:
    records = list(Records(root))
    records[index] |= values
    (root / RECORDS_PATH).write_text("".join(json.dumps(record) + "\n" for record in records))


def write_replay(
    path: Path,
    repo_id: str,
    robot: str,
    failures: dict[int, str],
    perturbed: dict[int, list[bool]] | None = None,
    frames: int | None = None,
) -> None:
    """What `cei-replay --json` would write."""
    shaken, long = perturbed or {}, {} if frames is None else {"frames": frames}
    results = [
        {"episode": i, "success": not failure, "failure": failure, "perturbed": shaken.get(i, []), **long}
        for i, failure in failures.items()
    ]
    rule = {"part": "Gripper", "kind": "servo", "source": "a rule", "says": "gains follow from inertia"}
    found = {"repo_id": repo_id, "embodiment": robot, "env": f"CEI-Pick-{robot}", "results": results}
    path.write_text(json.dumps(found | {"physics": {"rules": [rule], "joints": []}}))


def dataset(root: Path) -> list[str]:
    return [f"--dataset.repo_id=me/{root.name}", f"--dataset.root={root}"]


def beside(root: Path) -> list[str]:
    return [f"--source.repo_id=me/{root.name}", f"--source.root={root}"]


@pytest.fixture(scope="module")
def path(job: Path) -> Path:
    """The page of all there is."""
    files = [f"--replay={job / 'source.json'}:{job / 'replay.json'}", f"--output={job / 'report.html'}"]
    files.append(f"--json={job / 'report.json'}")
    assert cei_report.main([*dataset(job / "out"), *beside(job / "pick"), *files, "--films", "--worst=1"]) == 0
    return job / "report.html"


@pytest.fixture(scope="module")
def page(path: Path) -> Html:
    return Html(path.read_text())


# -- what it says ------------------------------------------------------------------------------------------------------


def test_the_table_has_what_records_and_replays_say(page: Html, job: Path) -> None:
    rows = page.rows("episode")
    assert len(rows) == EPISODES
    for row, record in zip(rows, Records(job / "out"), strict=True):
        assert row["source's"] == str(record["source_episode"])
        assert float(row["fidelity"]) == pytest.approx(record["fidelity"]["score"], abs=0.006)
        for part, share in record["fidelity"]["parts"].items():
            assert float(row[part]) == pytest.approx(share, abs=0.006), part
        assert float(row["pads (mm)"]) == pytest.approx(record["alignment"]["pad_distance_mm_mean"], abs=0.06)
        assert row["unreached"] == str(len(record["alignment"]["unreachable_frames"]))
    assert [row["replay"] for row in rows] == ["success", "success", "slipped"]
    assert [row["otherwise"] for row in rows] == ["2 of 2", "1 of 2", ""]
    assert [(row["kept"], row["held"]) for row in rows] == [("", ""), ("corrected", "20% → 100%"), ("", "")]
    replays = page.rows("robot")
    assert [(row["robot"], row["successes"], row["failures"]) for row in replays] == [
        (killed.ROBOT, "2 of 2", "none"),
        (ROBOT, "2 of 3", "slipped: 1"),
    ]
    assert replays[1]["slightly otherwise"].startswith("75% (")
    assert page.rows("of") == [
        {"of": "Gripper", "rule": "servo", "set by": "a rule", "what": "gains follow from inertia"}
    ]


def test_it_says_what_twins_show(job: Path, tmp_path: Path) -> None:
    root = tmp_path / "out"
    shutil.copytree(job / "out", root)
    said = [Evidence.of([False] * 4, ["box"], 1.0), Evidence.of([True] * 4, ["box"], 1.0), Evidence.none("no clouds")]
    for index, evidence in enumerate(said):
        change(root, index, evidence=evidence.record())
    files = [f"--output={tmp_path / 'report.html'}", f"--json={tmp_path / 'report.json'}"]
    assert cei_report.main([*dataset(root), *files, "--worst=1"]) == 0
    page, found = Html((tmp_path / "report.html").read_text()), json.loads((tmp_path / "report.json").read_text())
    assert [row["twin"] for row in page.rows("episode")] == ["fails (0 of 4)", "holds (4 of 4)", "cannot be judged"]
    assert "cannot be judged (no clouds)" in Episode(0, 1, twin=Twin("cannot be judged", reason="no clouds")).why()[0]
    assert found["shown"][0]["episode"] == 0  # the worst, whatever its fidelity
    assert "Played in a scene built from its recording: fails (0 of 4 tries hold)." in found["shown"][0]["why"]


def test_the_worst_fails_and_the_best_holds(page: Html, job: Path) -> None:
    found = json.loads((job / "report.json").read_text())
    assert [each["episode"] for each in found["shown"]] == [2, 0]  # that which fails, whatever its fidelity
    assert "Replayed, it fails: slipped." in found["shown"][0]["why"]
    assert "Replayed slightly otherwise, it succeeds in 2 of 2." in found["shown"][1]["why"]
    for each in found["shown"]:
        for sentence in each["why"]:
            assert sentence in page.text


def test_corrections_are_listed(page: Html) -> None:
    (row,) = page.rows("episode")[:0] + [
        dict(zip(*table, strict=True)) for table in page.tables if table[0][-1] == "what is other"
    ]
    assert row["episode"] == str(CORRECTED)
    assert row["what is other"] == str(CORRECTION) == "closing 6 mm, squeeze 1.3"


def test_what_is_left_out_and_not_known_is_said(page: Html, job: Path) -> None:
    assert (
        f"{killed.EPISODES - EPISODES} episodes of the source's {killed.EPISODES} are not in the dataset." in page.text
    )
    assert "Clouds are made of the depth of front." in page.text
    assert "me/out names no environment." in page.text
    assert "--source.repo_id" not in page.text.replace(page.preformatted, "")  # it is there
    provenance = json.loads((job / "out" / METADATA_PATH).read_text())["provenance"]
    assert provenance["command"] in page.preformatted
    assert provenance["versions"]["mujoco"] in page.text


def test_films_are_drawn_where_there_is_no_environment(page: Html) -> None:
    films = [content for kind, content in page.media if kind == "video/mp4"]
    assert len(films) == 2
    for content in films:
        with av.open(io.BytesIO(content)) as video:
            frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
        assert len(frames) in (killed.FRAMES, killed.FRAMES + 2)
        left, right = np.array_split(frames[0].astype(int), 2, axis=1)
        assert min(left.std(), right.std()) > 15  # source and target
        assert np.abs(frames[0].astype(int) - frames[-1]).max() > 60
    assert "Drawn from joints, pads and clouds." in page.text


def test_pictures_are_there(page: Html) -> None:
    pictures = [content for kind, content in page.media if kind != "video/mp4"]
    assert len(pictures) == 4  # residuals, two episodes, clouds
    for content in pictures:
        picture = np.asarray(Image.open(io.BytesIO(content)).convert("L"))
        assert min(picture.shape) > 200 and picture.std() > 10


def test_a_dataset_alone_gets_a_page_that_says_what_is_not_known(job: Path, capsys: pytest.CaptureFixture) -> None:
    assert cei_report.main([*dataset(job / "pick"), f"--output={job / 'alone.html'}"]) == 0
    found = Html((job / "alone.html").read_text())
    assert [row["frames"] for row in found.rows("episode")] == [str(killed.FRAMES + i) for i in range(killed.EPISODES)]
    for said in (
        "recorded, not converted",
        "Whether episodes succeed in simulation: it names no environment to replay it in.",
        "How well episodes follow: their records have no fidelity",
        "it has no point clouds",
        "How it looks in motion: --films.",
    ):
        assert said in found.text
    assert "the best" not in found.text  # of which nothing is known
    assert [kind for kind, _ in found.media] == ["image/webp"]
    assert "not known: How it looks in motion: --films." in capsys.readouterr().out


def test_memory_has_the_worst_of_many() -> None:
    n = 5 * MOST
    scores = np.random.default_rng(0).permutation(n) / n
    replayed = {7: Replayed("slipped"), 8: Replayed("", (True, False))}
    many = (Episode(i, 10, fidelity=float(scores[i]), replayed=replayed.get(i)) for i in range(n))
    summary = Summary.of(many)
    assert (summary.count, summary.frames, len(summary.rows())) == (n, 10 * n, MOST)
    assert np.median(summary.fidelities) == pytest.approx(np.median(scores))
    others = [i for i in np.argsort(scores) if i not in replayed]
    worst = [7, 8, *others[: MOST - 2]]
    assert [each.index for each in summary.rows()] == worst
    assert [each.index for each in summary.shown(3)] == [*worst[:3], others[-1]]


# -- strangers ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hostile(job: Path) -> Path:
    """The page of a dataset whose every text is bad."""
    root = shutil.copytree(job / "out", job / "hostile")
    record = Records(root)[0]
    alignment = record["alignment"] | {"penetrates": BAD, "unreachable_because": BAD, "unreachable_frames": [0]}
    fidelity, quality = {"score": 0.1, "parts": {"reach": 0.1, BAD: 0.5}}, {"probability": 0.1, "by": BAD}
    said = {"success": False, "how": BAD, "failure": BAD, "attempts": 1}
    change(root, 0, alignment=alignment, fidelity=fidelity, quality=quality, verified=said, **{BAD: BAD})
    path = root / METADATA_PATH
    metadata = json.loads(path.read_text())
    provenance = metadata["provenance"]
    provenance |= {"command": BAD, "git_commit": BAD, "date": BAD, "versions": {BAD: BAD}, "notes": {BAD: [BAD]}}
    provenance["source"] |= {"repo_id": BAD, "embodiment": BAD, "carried": [BAD], "dropped": {BAD: BAD}}
    provenance["options"] |= {BAD: BAD, "gate": {"dropped": [BAD]}, "min_quality": BAD, "refine": {"common": {BAD: 1}}}
    path.write_text(json.dumps(metadata))
    write_replay(job / "hostile.json", "me/hostile", ROBOT, {0: BAD})
    files = [f"--replay={job / 'hostile.json'}", f"--output={job / 'hostile.html'}", "--worst=1"]
    assert cei_report.main([*dataset(root), *files]) == 0
    return job / "hostile.html"


def test_a_strangers_text_stays_text(hostile: Path) -> None:
    found = Html(hostile.read_text())
    assert "script" not in found.tags
    assert found.text.count("document.title='owned'") >= 8
    assert "{{ 7 * 7 }}" in found.text and "49" not in found.preformatted


def test_records_of_other_shapes_are_no_crash(job: Path, tmp_path: Path) -> None:
    root = shutil.copytree(job / "out", tmp_path / "out")
    change(root, 0, fidelity=[1], quality=[1], alignment="x", verified=3, source_episode="0")
    change(
        root,
        1,
        quality={"probability": 7, "by": 3},
        fidelity={"score": 7, "parts": {"reach": "x", "limits": True}},
        alignment={"a": [[]]},
        verified={},
    )
    change(
        root,
        2,
        fidelity={"score": float("nan"), "parts": 3},
        quality={"probability": "x"},
        verified={"held": "x", "how": ["y"], "success": 0},
    )
    assert cei_report.main([*dataset(root), f"--output={tmp_path / 'r.html'}"]) == 0
    rows = Html((tmp_path / "r.html").read_text()).rows("episode")
    assert len(rows) == EPISODES and not {"fidelity", "quality"} & set(rows[0])


def test_a_name_that_the_template_does_not_get_is_an_error() -> None:
    with pytest.raises(Exception, match="undefined"):
        render({})


# -- a browser -----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_browser_shows_it_light_and_dark_and_on_a_telephone(path: Path, tmp_path: Path) -> None:
    (tmp_path / "profile").mkdir()
    with browse(path.resolve().as_uri(), tmp_path / "profile") as shown:
        shown.wait("document.readyState === 'complete'")
        broken = "[...document.images].filter(i => !(i.complete && i.naturalWidth > 200)).length"
        assert shown.evaluate("document.images.length") == 4 and shown.evaluate(broken) == 0
        shown.wait("[...document.querySelectorAll('video')].every(v => v.videoWidth > 200)")
        assert (
            shown.evaluate("performance.getEntriesByType('resource').filter(r => !r.name.startsWith('data:')).length")
            == 0
        )
        colours = []
        for scheme in ("light", "dark"):
            shown.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            colours.append(shown.evaluate("getComputedStyle(document.body).backgroundColor"))
            shown.picture(tmp_path / f"{scheme}.png")
        means = [np.asarray(Image.open(tmp_path / f"{scheme}.png").convert("L")).mean() for scheme in ("light", "dark")]
        assert colours[0] == "rgb(255, 255, 255)" and means[0] > 180 > 110 > means[1]
        shown.call("Emulation.setDeviceMetricsOverride", width=390, height=800, deviceScaleFactor=1, mobile=True)
        assert shown.evaluate("document.documentElement.scrollWidth") <= 390  # wide tables scroll in themselves


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_a_browser_runs_nothing_of_a_stranger(hostile: Path, tmp_path: Path) -> None:
    (tmp_path / "profile").mkdir()
    with browse(hostile.resolve().as_uri(), tmp_path / "profile") as shown:
        shown.wait("document.readyState === 'complete'")
        assert shown.evaluate("document.title") != "owned"
        assert shown.evaluate("document.scripts.length") == 0


# -- what is refused -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--output={there}"], "already exists; choose another file, remove it first, or replace it with --overwrite"),
        (["--output={new}.pdf"], "should end in .html or .htm"),
        (["--output={out}/r.html"], "is inside the dataset"),
        (["--worst=-1"], "--worst=-1 should be at least 0"),
        (["--replay={new}"], "cannot be read"),
        (["--replay={report}"], "is no result of cei-replay --json"),
        (["--replay={text}"], "cannot be read"),
        (["--replay={source}"], "of me/pick (Panda-PandaGripper), not of me/out (UR5e-PandaGripper); if it is of what"),
        (["--replay={replay}:{replay}"], "two --replay are of me/out"),
        (["--replay={beyond}"], "is of episode 7 of me/out, which has 0 to 2"),
        (
            ["--source.repo_id=me/out", "--source.root={out}"],
            "was converted from Panda-PandaGripper; --source is of UR5e",
        ),
        (["--replay={older}"], "has 3 frames of episode 0 of me/out, which has 6; replay it again"),
        (["--source.root={pick}"], "--source.root is of no use without --source.repo_id"),
        (["--dataset.root={new}"], "no LeRobot dataset in"),
    ],
)
def test_bad_input_gives_one_line_and_leaves_nothing(
    options: list[str], message: str, job: Path, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    (tmp_path / "there.html").write_text("<!doctype html>mine")
    (tmp_path / "text").write_text("no JSON")
    (tmp_path / "report.json").write_text('{"results": [{"episode": 0}]}')
    write_replay(tmp_path / "beyond.json", "me/out", ROBOT, {7: ""})
    write_replay(tmp_path / "older.json", "me/out", ROBOT, {0: ""}, frames=3)
    names = {
        "there": "there.html",
        "text": "text",
        "report": "report.json",
        "beyond": "beyond.json",
        "older": "older.json",
        "new": "new",
    }
    paths = {name: tmp_path / file for name, file in names.items()}
    paths |= {"out": job / "out", "pick": job / "pick", "source": job / "source.json", "replay": job / "replay.json"}
    before = sorted(tmp_path.rglob("*"))
    filled = [option.format(**paths) for option in options]
    given = {option.partition("=")[0] for option in filled}
    args = [*dataset(job / "out"), f"--output={tmp_path / 'made.html'}"]
    assert cei_report.main([*(arg for arg in args if arg.partition("=")[0] not in given), *filled]) in (1, 2)
    assert message in complaint()
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "there.html").read_text() == "<!doctype html>mine"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"correction": {}, "frame": 99, "plain_qpos": []}, "verified.corrected.frame should be 0 to"),
        ({"correction": {"squeeze": -1}, "frame": 0, "plain_qpos": []}, "is no correction"),
        ({"correction": {"magic": 1}, "frame": 0, "plain_qpos": []}, "is no correction"),
        ({"correction": {}, "frame": 0, "plain_qpos": [0.0]}, "plain_qpos should be 8 finite numbers"),
        ([], "is no correction"),
    ],
)
def test_what_is_no_correction_is_refused(
    value: Any, message: str, job: Path, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    root = shutil.copytree(job / "out", tmp_path / "out")
    change(root, 0, verified={"corrected": value})
    assert cei_report.main([*dataset(root), f"--output={tmp_path / 'r.html'}"]) == 1
    assert message in complaint()
    assert not (tmp_path / "r.html").exists()


def test_a_page_is_replaced_if_asked_for_and_only_when_it_is_whole(
    job: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    path = tmp_path / "r.html"
    path.write_text("<!doctype html>old")
    args = [*dataset(job / "pick"), f"--output={path}", "--overwrite"]

    def fails(*_: Any) -> str:
        raise OSError("the disk is full")

    monkeypatch.setattr("cei_converters.report.page.render", fails)
    assert cei_report.main(args) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["r.html"]
    assert path.read_text() == "<!doctype html>old"
    monkeypatch.undo()
    assert cei_report.main(args) == 0
    assert "Panda-PandaGripper, as recorded" in path.read_text()
