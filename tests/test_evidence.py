"""`cei-convert --evidence`: what twins say is of each episode in its records, in the table, the card and the result; and options that cannot be."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conversions import record_cubes, records, same
from pages import Html

from cei_converters import convert, report
from cei_converters.conversion.evidence import EvidenceOptions, Witness, row, sentence, summarise
from cei_converters.sources.reader import DatasetReader
from cei_gym.displacement import Displacement
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer
from cei_gym.twin import Evidence
from cei_gym.twin.calibration import WORKED

TARGET = "IIWA-Inspire"
FAST = ["--clouds.robot_points=256", "--clouds.points=256", "--init.starts=32", "--init.basins=4"]
ASKED = ["--evidence", "--evidence.density_kg_m3=500"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds `source`, a recorded dataset of two episodes, and `target`, what becomes of it with evidence."""
    folder = tmp_path_factory.mktemp("evidence")
    record_cubes(folder / "source", 2, 3)
    assert converted(folder, folder / "target", *ASKED, "--workers=1") == 0
    return folder


def converted(folder: Path, root: Path, *options: str) -> int:
    source = ["--dataset.repo_id=me/source", f"--dataset.root={folder / 'source'}"]
    target = [f"--target={TARGET}", "--new_repo_id=me/target", f"--new_root={root}"]
    return convert.main([*source, *target, *FAST, f"--json={root}.json", *options])


def test_each_episode_says_what_its_twin_showed(folder: Path) -> None:
    said = [record["evidence"] for record in records(folder / "target")]
    assert [each["answer"] for each in said] == ["holds", "holds"]  # both do in their environment
    assert all(each["held"] == each["tries"] and each["shapes"] for each in said)
    result = json.loads((folder / "target.json").read_text())
    assert result["evidence"] == {"answers": {"holds": 2}, "reasons": {}, "dropped": []}
    card = (folder / "target/README.md").read_text()
    assert "## Evidence of twins" in card and "Assumed of what is held: 500 kg/m^3, friction 0.8." in card
    assert "| holds | 2 |" in card


def test_what_fails_in_its_twin_is_left_out_if_told(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture, complaint: Callable
) -> None:
    """Of steel, the source's gripper holds both cubes and the hand holds none; somewhat lighter, the second falls."""
    heavy = ["--evidence", "--evidence.drop", "--workers=1"]
    assert converted(folder, tmp_path / "heavy", *heavy, "--evidence.density_kg_m3=3550") == 0
    assert "1 fails; left out: episode 1." in capsys.readouterr().out
    assert [record["source_episode"] for record in records(tmp_path / "heavy")] == [0]
    assert json.loads((tmp_path / "heavy.json").read_text())["evidence"]["dropped"] == [1]
    assert "Episodes that fail in it are left out (1)." in (tmp_path / "heavy/README.md").read_text()
    dataset = ["--dataset.repo_id=me/target", f"--dataset.root={tmp_path / 'heavy'}"]
    assert report.main([*dataset, f"--output={tmp_path / 'page.html'}", "--worst=1"]) == 0
    page = (tmp_path / "page.html").read_text()
    assert "1 episode of the source (1): it fails in a twin of its recording (--evidence.drop)." in page
    assert converted(folder, tmp_path / "steel", *heavy, "--evidence.density_kg_m3=8000") == 1
    assert "all 2 episodes fail in their twins, so all are left out and nothing is written" in complaint()
    assert not (tmp_path / "steel").exists()


def test_the_gate_goes_by_what_twins_say(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """By what the answers were worth elsewhere: none is worth 0.99, that of what falls less than a half."""
    gate = ["--evidence", "--evidence.density_kg_m3=3550", "--min_quality=0.5", "--flag=0.99", "--workers=1"]
    assert converted(folder, tmp_path / "gated", *gate) == 0
    assert "Quality: dropped 1 (episode 1), flagged 1 (episode 0)." in capsys.readouterr().out
    (kept,) = records(tmp_path / "gated")
    assert kept["source_episode"] == 0 and kept["flagged"]
    works, of = WORKED[kept["evidence"]["answer"]]
    assert kept["quality"] == {"probability": pytest.approx((works + 1) / (of + 2)), "by": "twin"}
    card = (tmp_path / "gated/README.md").read_text()
    assert "by a scene built from its recording. It is known of 1 of 1 episodes" in card
    assert "Episodes not known to work with a probability of at least 0.5 are left out (1)." in card
    dataset = ["--dataset.repo_id=me/target", f"--dataset.root={tmp_path / 'gated'}"]
    assert report.main([*dataset, f"--output={tmp_path / 'page.html'}", "--worst=1"]) == 0
    (row,) = Html((tmp_path / "page.html").read_text()).rows("episode")
    assert float(row["quality"]) == pytest.approx(kept["quality"]["probability"], abs=0.006)


def test_workers_make_the_same_dataset(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    root = tmp_path / "target"
    assert converted(folder, root, *ASKED, "--workers=2", "--shard_episodes=1") == 0
    printed = capsys.readouterr().out
    assert "Evidence of twins: 2 holds." in printed and "holds 4/4" in printed
    same(root, folder / "target")


def test_without_it_nothing_is_said_and_what_was_said_is_not_carried_on(folder: Path, tmp_path: Path) -> None:
    """A conversion of a conversion is another motion, of which the first one's evidence says nothing."""
    source = ["--dataset.repo_id=me/target", f"--dataset.root={folder / 'target'}"]
    target = ["--target=Panda-PandaGripper", "--new_repo_id=me/back", f"--new_root={tmp_path / 'back'}"]
    assert convert.main([*source, *target, *FAST]) == 0
    assert not any("evidence" in record for record in records(tmp_path / "back"))
    assert "Evidence of twins" not in (tmp_path / "back/README.md").read_text()


def test_answers_are_counted_with_reasons() -> None:
    some = [Evidence.of([True] * 4, ["box"], 1.0), Evidence.of([True, False], ["box"], 1.0), Evidence.none("no clouds")]
    said = [each.record() for each in some]
    assert [row(each) for each in said] == ["holds 4/4", "unsure 1/2", "cannot be judged"]
    assert sentence(summarise(said)) == "1 holds, 1 unsure, 1 cannot be judged (no clouds: 1)"


def test_episodes_whose_objects_were_moved_cannot_be_judged(folder: Path) -> None:
    """As a package's step may move them."""
    demonstration = DatasetReader("me/source", folder / "source").read(0)
    transfer = Transfer(load_embodiment("Panda-PandaGripper"), load_embodiment("Panda-PandaGripper"))
    transfer.fit([demonstration])
    aligned = transfer.aligned(demonstration)
    moved, _ = transfer.made(aligned, clouds=False)
    witness, nowhere = Witness(transfer, EvidenceOptions(enabled=True)), np.tile(np.eye(4), (len(demonstration), 1, 1))
    assert witness(aligned, moved).answer == "holds"
    elsewhere = replace(demonstration, displacement=Displacement(np.eye(4), nowhere))
    assert "objects were moved" in witness(replace(aligned, demonstration=elsewhere), moved).reason


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--evidence.drop"], "--evidence.drop is of no use without --evidence."),
        (["--evidence.friction=0.5"], "--evidence.friction is of no use without --evidence."),
        (["--evidence", "--evidence.friction=-1.5"], "evidence.friction=-1.5 must be a finite number over 0."),
        (["--evidence", "--evidence.tries=0"], "evidence.tries=0 must be at least 1."),
        (["--evidence", "--evidence.seed=-1"], "--evidence.seed=-1 should be at least 0."),
        (["--evidence", "--evidence.density_kg_m3=inf"], "--evidence.density_kg_m3=inf should be a finite number."),
        (["--evidence", "--augment.grid=2,2"], "--evidence needs what cameras saw of objects"),
        (["--evidence", "--verify"], "ask the environment itself"),
    ],
)
def test_bad_options(folder: Path, tmp_path: Path, complaint: Callable, options: list[str], says: str) -> None:
    assert converted(folder, tmp_path / "target", *options) == 2
    assert says in complaint()


def test_options_reach_the_twin() -> None:
    options = replace(EvidenceOptions(enabled=True), friction=0.5, tries=3, seed=2).twin
    assert (options.friction, options.tries, options.seed) == (0.5, 3, 2)
