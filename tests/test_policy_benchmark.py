"""`cei-benchmark policy` through the real command, on next to nothing."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cei_converters.benchmark import command, paper
from cei_converters.benchmark.figures import Manifest
from cei_converters.benchmark.policy_stages import VARIANTS, PolicyCell, Stages, Training, Trials
from cei_converters.sources.reader import DatasetReader

PAPER = Path(__file__).parents[2] / "shared/paper/policy_success.csv"
CELL = "PickCube-UR5e-FourierRight"
FINISHED = ("no_inference_augmentation", "cei", "mean_action", "one_demonstration")
"""Variants that are run to the end: two of one training, and those that look at nothing."""
PREPARED = ("no_augmentation",)
"""Variants whose dataset is made, and no more: it is trained and evaluated as the first of the others are."""
SMOKE = ["policy", "--tasks=PickCube", "--targets=UR5e-FourierRight", "--demonstrations=2", "--episodes=1", "--seed=3"]
SMALL = ["--episode_length=6", "--training.steps=2", "--training.batch_size=4", "--training.points=32"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("benchmark")
    places = [f"--results={folder / 'results'}", f"--work={folder / 'work'}"]
    for variant in (*PREPARED, "cei"):  # nothing is trained yet
        assert command.main([*SMOKE, *SMALL, *places, "--stage=evaluate", f"--variants={variant}"]) != 0
    assert command.main([*SMOKE, *SMALL, *places, "--stage=train", "--variants=cei"]) == 0
    assert not list((folder / "results").glob("*.json"))
    assert command.main([*SMOKE, *SMALL, *places, f"--variants={','.join(FINISHED)}"]) == 0
    return folder


def test_variants_become_cells_that_share_a_training(folder: Path) -> None:
    assert {*FINISHED, *PREPARED} == {*VARIANTS}
    for variant in FINISHED:
        name = f"{CELL}-{variant}" + ("" if variant in ("mean_action", "one_demonstration") else "-0")
        result = json.loads((folder / "results" / f"{name}.json").read_text())
        assert result["successes"] == [False]
        assert result["trials"] == {"first_seed": 3, "count": 1, "length": 6}
        assert result["commit"]
    assert [path.name for path in (folder / "work/trained").iterdir() if path.is_dir()] == [f"{CELL}-swapped-0"]
    said = {
        kind: (folder / f"work/datasets/{CELL}-{kind}/README.md").read_text() for kind in ("swapped", "as_recorded")
    }
    assert "still show the source robot" in said["as_recorded"]
    assert "still show the source robot" not in said["swapped"]
    shown = [DatasetReader("me/any", folder / f"work/datasets/{CELL}-{kind}").read(0) for kind in said]
    clouds = [np.mean(demonstration.point_cloud_world, axis=(0, 1)) for demonstration in shown]
    assert not np.allclose(*clouds, atol=1e-4)


def test_each_file_says_what_it_depends_on(folder: Path) -> None:
    manifest = Manifest.read(folder / "results")
    manifest.check()
    figure = manifest.figure(f"{CELL}-cei-0.json")
    assert figure.command.startswith("cei-benchmark policy --tasks=PickCube --targets=UR5e-FourierRight --variants=")
    assert figure.seeds == (3, 3)
    assert "lerobot_policy_dp3" in figure.versions
    assert manifest.code[str(figure.code)]["policies/lerobot_policy_dp3/unet.py"]
    assert {*manifest.figure("policy.md").files} == {"policy.md", "policy.csv", "success.png", "learning.png"}


def test_a_learning_curve_counts_steps_once_however_often_training_was_stopped(tmp_path: Path) -> None:
    stages = Stages(tmp_path, 1, 0.0, Trials(0, 1, 1), Training(steps=400))
    cell = PolicyCell("PickCube", "UR5e-FourierRight", "cei")
    line = "INFO ot_train.py:641 step:{0} smpl:1K ep:1 epch:{1} loss:{2} grdn:0.1 lr:1e-3 updt_s:0.2 data_s:0.0\n"
    logged = [("0K", 1.0, 0.9), ("0K", 2.0, 0.5), ("0K", 3.0, 0.4), ("0K", 3.0, 0.3), ("0K", 4.0, 0.2)]
    log = stages.trained(cell).with_suffix(".log")
    log.parent.mkdir(parents=True)
    log.write_text("Training: 1%\r" + "".join(line.format(*values) for values in logged) + "other: line\n")
    assert stages.losses(cell) == [(100, 0.9), (200, 0.5), (300, 0.3), (400, 0.2)]


def test_the_report_stands_beside_the_papers_figures(folder: Path) -> None:
    rows = list(csv.DictReader((folder / "results/policy.csv").open()))
    assert [row["variant"] for row in rows] == list(FINISHED)
    assert next(row for row in rows if row["variant"] == "cei")["paper_percent"] == "79"
    assert "| PickCube | CEI | 0 / 79 |" in (folder / "results/policy.md").read_text()
    for picture in ("success.png", "learning.png"):
        assert np.asarray(Image.open(folder / "results" / picture)).std() > 5


def test_finished_cells_are_kept_and_other_settings_refused(folder: Path, capsys: pytest.CaptureFixture) -> None:
    places = [f"--results={folder / 'results'}", f"--work={folder / 'work'}"]
    before = {path: path.stat().st_mtime_ns for path in (folder / "results").glob("*.json")}
    finished = f"--variants={','.join(FINISHED)}"
    assert command.main([*SMOKE, *SMALL, *places, finished]) == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    capsys.readouterr()
    assert command.main([*SMOKE, *SMALL, *places, finished, "--training.lr=0.5"]) != 0
    assert "other settings (training" in capsys.readouterr().err
    assert command.main([*SMOKE, *places, "--variants=best"]) != 0
    assert "no_inference_augmentation" in capsys.readouterr().err


def test_the_papers_figures_are_the_papers() -> None:
    names = {
        "No augmentation": "no_augmentation",
        "CEI without inference augmentation": "no_inference_augmentation",
        "CEI": "cei",
    }
    for row in csv.DictReader(PAPER.open()):
        figures = [int(value) for key, value in row.items() if key not in ("task", "method", "average")]
        assert paper.POLICY[row["task"]][names[row["method"]]] == tuple(figures)
