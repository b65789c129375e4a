"""`cei-benchmark real` through the real command, on next to nothing: one task, one demonstration, two steps of training."""

import csv
import json
import time
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from third_party import SHARED, needs_robots

from cei_converters.benchmark import command, paper
from cei_converters.benchmark.figures import Manifest
from cei_converters.benchmark.policy_stages import Stages, Training, Trials
from cei_converters.benchmark.real_found import Found, of_paper
from cei_converters.benchmark.real_picture import draw
from cei_converters.benchmark.real_report import write_report
from cei_converters.benchmark.real_tasks import TASKS, transfer_ratio
from cei_converters.dataset.metadata import Metadata
from cei_converters.sources.reader import DatasetReader
from cei_gym.embodiment import load_embodiment

PAPER = SHARED / "paper/real_world.csv"
SMOKE = ["real", "--tasks=PushCube", "--episodes=1", "--demonstrations=1", "--trials=1", "--jobs=1"]
SMALL = ["--episode_length=6", "--training.steps=2", "--training.batch_size=4", "--training.points=32"]
REPLAYS = ["PushCube-UR5e-AG95", "PushCube-UR5e-XHand"]
POLICIES = ["PushCube-UR5e-AG95-source-0", "PushCube-UR5e-XHand-cei-0"]


@pytest.fixture(scope="module")
def folder(third_party_robots: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`results` and `work`: replayed, then everything, with a film of what was replayed already."""
    folder = tmp_path_factory.mktemp("real")
    assert command.main([*SMOKE, *SMALL, *places(folder), "--stage=replay"]) == 0
    kept = [(folder / f"results/{name}.json").read_bytes() for name in REPLAYS]
    assert not [*folder.glob("results/*-0.json"), *folder.glob("results/films/*")]
    assert command.main([*SMOKE, *SMALL, *places(folder), "--stage=evaluate"]) == 1  # nothing is trained yet
    assert not [*folder.glob("results/*-0.json"), *folder.glob("work/trained/*")]
    assert command.main([*SMOKE, *SMALL, *places(folder), "--films"]) == 0
    assert kept == [(folder / f"results/{name}.json").read_bytes() for name in REPLAYS]
    return folder


def places(folder: Path) -> list[str]:
    return [f"--results={folder / 'results'}", f"--work={folder / 'work'}"]


def cell_of(folder: Path, name: str) -> dict:
    return json.loads((folder / f"results/{name}.json").read_text())


@needs_robots
def test_a_task_is_replayed_and_learnt_on_target_and_source(folder: Path) -> None:
    own, replayed = (cell_of(folder, name) for name in REPLAYS)
    assert (own["source"], own["target"], "alignment" in own) == ("UR5e-AG95", "UR5e-AG95", False)
    assert (replayed["source"], replayed["target"], replayed["options"]) == ("UR5e-AG95", "UR5e-XHand", [])
    assert replayed["seeds"] == [2000, 2000] and replayed["source_seeds"] == [2000]
    assert own["replay"]["successes"] == replayed["replay"]["successes"] == 1
    assert "stock_replay" not in replayed
    own, learnt = (cell_of(folder, name) for name in POLICIES)
    assert (own["source"], own["target"], own["variant"]) == ("UR5e-AG95", "UR5e-AG95", "source")
    assert (learnt["source"], learnt["target"], learnt["variant"]) == ("UR5e-AG95", "UR5e-XHand", "cei")
    for policy in (own, learnt):
        assert policy["trials"] == {"first_seed": 2000, "count": 1, "length": 6}
        assert (policy["successes"], policy["source_seeds"], policy["variation"]) == ([False], [0], 1)
        assert "device" not in policy["training"]


@needs_robots
def test_the_sources_own_policy_has_its_own_joints_and_what_cameras_saw(folder: Path) -> None:
    datasets = folder / "work/datasets"
    recorded, own = (DatasetReader("me/any", datasets / f"PushCube-UR5e-AG95{kind}") for kind in ("", "-as_recorded"))
    before, after = recorded.read(0), own.read(0)
    for channel in ("qpos", "action", "environment_state"):
        np.testing.assert_array_equal(getattr(before, channel), getattr(after, channel))
    assert not after.depth_m and after.point_cloud_world is not None
    assert after.point_cloud_world.shape == (len(before), 1024, 3)
    metadata = Metadata.load(own.root)
    assert (metadata.clouds, str(metadata.environment.id)) == (None, "CEI-PushCube-UR5e-AG95")
    low, high = before.scene.workspace_world
    assert (after.point_cloud_world > low - 1e-6).all() and (after.point_cloud_world < high + 1e-6).all()
    assert own.record(0)["seed"] == 0


@needs_robots
def test_a_film_shows_source_and_target(folder: Path) -> None:
    film = folder / "results/films/PushCube.mp4"
    assert 10_000 < film.stat().st_size < 400_000
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) > 30
    left, right = np.split(frames[-1].astype(int), [frames[-1].shape[1] // 2], axis=1)
    assert min(left.std(), right.std()) > 10 and abs(left - right[:, -left.shape[1] :]).mean() > 3
    assert Image.open(film.with_suffix(".png")).size[0] > 1000


@needs_robots
def test_each_file_says_what_it_depends_on(folder: Path) -> None:
    manifest = Manifest.read(folder / "results")
    manifest.check()
    said = "--tasks=PushCube --episodes=1"
    for name in REPLAYS:
        figure = manifest.figure(f"{name}.json")
        assert figure.command.startswith(f"cei-benchmark real --stage=replay {said}")
        assert figure.seeds == (2000, 2000) and "policies/lerobot_policy_dp3/*" not in figure.measures
    for name in POLICIES:
        figure = manifest.figure(f"{name}.json")
        assert figure.command.startswith(f"cei-benchmark real --stage=policy {said}")
        assert "lerobot_policy_dp3" in figure.versions and "policies/lerobot_policy_dp3/*" in figure.measures
    assert "--films" in manifest.figure("films/PushCube.mp4").command
    derived = manifest.figure("real.md")
    assert {*derived.files} == {"real.md", "real.csv", "real.png"} and derived.made_of
    assert "--tasks" not in derived.command and derived.command.endswith(" --redraw")


@needs_robots
def test_it_resumes_where_nothing_is_left_and_refuses_other_settings(folder: Path, complaint: Callable) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.suffix in (".json", ".mp4")}
    start = time.perf_counter()
    assert command.main([*SMOKE, *SMALL, *places(folder), "--films"]) == 0
    assert command.main(["real", "--redraw", *SMOKE[2:-1], *SMALL, *places(folder)]) == 0
    assert time.perf_counter() - start < 20
    assert {path: path.stat().st_mtime_ns for path in before} == before
    for option, said in (
        ("--episodes=2", "settings (seeds: [2000, 2000], here [2000, 2001]); remove it or"),
        ("--training.lr=0.5", "other settings (training: "),
        ("--variation=0.5", "other settings (variation: 1.0, here 0.5)"),
    ):
        options = [each for each in (*SMOKE, *SMALL) if each.partition("=")[0] != option.partition("=")[0]]
        assert command.main([*options, *places(folder), option]) == 1
        assert said in complaint()


@needs_robots
def test_the_tables_stand_beside_the_papers(folder: Path) -> None:
    with (folder / "results/real.csv").open() as file:
        rows = {(row["stage"], row["robot"]): row for row in csv.DictReader(file)}
    assert [*rows] == [(stage, robot) for stage in ("replay", "policy") for robot in ("UR5e-XHand", "UR5e-AG95")]
    assert rows["replay", "UR5e-XHand"]["successes"] == rows["replay", "UR5e-XHand"]["of"] == "1"
    assert 0.5 < float(rows["replay", "UR5e-XHand"]["fidelity_mean"]) < 1
    assert [rows["policy", robot]["paper_successes"] for robot in ("UR5e-XHand", "UR5e-AG95")] == ["10", "10"]
    text = (folder / "results/real.md").read_text()
    assert "| AG95 to XHand | PushCube | 0 of 1 | 0% to 79% | 0 of 1 | 0% to 79% | - | 10 of 10 | 10 of 10 |" in text
    assert "physics are simulated" in text and "where people teleoperate" in text
    assert np.asarray(Image.open(folder / "results/real.png")).std() > 5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--tasks=PushCup",),
            "unknown task 'PushCup'. Did you mean 'PushCube'? Valid: PushCube, OpenDrawer, PlaceBird",
        ),
        (("--tasks=PressButton", "--stage=policy"), "--tasks=PressButton is only replayed"),
        (("--redraw", "--results=nowhere"), "no cell is finished in nowhere."),
    ],
)
def test_bad_input_is_one_clear_line(
    options: tuple[str, ...], message: str, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    given = [each for each in places(tmp_path) if each.partition("=")[0] not in " ".join(options)]
    assert command.main(["real", *given, *options]) == 1
    assert message in complaint()


def test_a_robot_without_its_description_is_said_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, complaint: Callable[[], str]
) -> None:
    monkeypatch.delenv("CEI_GYM_PACKAGE_PATH", raising=False)
    load_embodiment.cache_clear()
    assert command.main([*SMOKE, *places(tmp_path)]) == 1
    assert "CEI_GYM_PACKAGE_PATH" in complaint()
    assert not [*tmp_path.iterdir()]
    load_embodiment.cache_clear()


# -- arithmetic, of made-up cells -----------------------------------------------------------------------------------------


@pytest.mark.skipif(not PAPER.exists(), reason="needs ../shared/paper")
def test_the_papers_figures_are_the_papers() -> None:
    with PAPER.open() as file:
        for row in csv.DictReader(file):
            target, own = of_paper(TASKS[row["task"]])
            assert [row["cei"], row["source"]] == [f"{rate.successes}/{rate.of}" for rate in (target, own) if rate]
            assert row["direction"] == TASKS[row["task"]].direction
    assert TASKS.keys() - paper.REAL.keys() == {"PressButton"}


def test_the_transfer_ratio_is_that_of_the_means() -> None:
    figures = [(target / 10, own / 10) for target, own in paper.REAL.values()]
    assert transfer_ratio(figures) == pytest.approx(0.824, abs=5e-4)  # as the paper says
    assert transfer_ratio([(0.5, 1.0), (1.0, 0.5)]) == 1.0
    assert transfer_ratio([]) is transfer_ratio([(0.0, 0.0)]) is None


def made_up(target: dict[str, int], own: dict[str, int]) -> Found:
    """Policies by successes of 20."""

    def result(task: str, successes: int) -> dict:
        seeds = {"first_seed": 2000, "count": 20, "length": 400}
        trials = [True] * successes + [False] * (20 - successes)
        return {"successes": trials, "commit": "c", "demonstrations": 25, "variation": 1.0, "trials": seeds}

    cells = {TASKS[task].policy: result(task, count) for task, count in target.items()}
    return Found({}, cells | {TASKS[task].own_policy: result(task, count) for task, count in own.items()})


def test_averages_and_ratios_compare_over_the_same_tasks(tmp_path: Path) -> None:
    found = made_up({"PushCube": 20, "PlaceBird": 10, "PickCup": 16}, {"PushCube": 20, "PickCup": 20})
    text = write_report(found, tmp_path)
    assert "| AG95 to XHand | PlaceBird | 10 of 20 | 30% to 70% | - | - | - | 7 of 10 | 10 of 10 | 70.0% |" in text
    assert "| **AG95 to XHand** | average of 1 | 100.0% |  | 100.0% |  | 100.0% | 100.0% | 100.0% | 100.0% |" in text
    assert "| **XHand to AG95** | average of 1 | 80.0% |  | 100.0% |  | 80.0% | 60.0% | 80.0% | 75.0% |" in text
    assert "| **all** | average of 2 | 90.0% |  | 100.0% |  | 90.0% | 80.0% | 90.0% | 88.9% |" in text
    assert "## Replay" not in text
    draw(found, tmp_path / "real.png")
    assert np.asarray(Image.open(tmp_path / "real.png")).std() > 5


def test_names_of_cells_and_datasets_do_not_collide(tmp_path: Path) -> None:
    cells = [cell for task in TASKS.values() for cell in (task.policy, task.own_policy)]
    stages = Stages(tmp_path, 25, 1.0, Trials(2000, 20, 400), Training())
    for names in ({cell.name for cell in cells}, {cell.dataset for cell in cells}, {stages.trained(c) for c in cells}):
        assert len(names) == len(cells)
    assert TASKS["PickCup"].policy.dataset == "PickCup-UR5e-AG95-of-UR5e-XHand-swapped"
