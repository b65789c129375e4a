"""`cei-benchmark replay` through the real command: six cells, one of which fails at first, and what it makes of them."""

import contextlib
import csv
import fnmatch
import io
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import cei_gym
from cei_converters.benchmark import command, jobs, paper
from cei_converters.benchmark.cells import END_EFFECTORS, SOURCE, TABLES, TARGETS, TASKS, Cell, all_cells, own_tasks
from cei_converters.benchmark.figures import Manifest
from cei_converters.benchmark.heat_map import write_heat_map
from cei_converters.benchmark.results import Results, source_of
from cei_converters.benchmark.robots import beyond_the_paper, finished_robots, robot_cells, robots_markdown
from cei_converters.benchmark.robots import rows as rows_of
from cei_converters.benchmark.runner import Job, run_jobs
from cei_converters.benchmark.tables import averages, markdown, shown
from cei_converters.cli import DatasetConfig
from cei_converters.convert import ConvertConfig, convert
from cei_gym.embodiment import ARMS
from cei_gym.errors import CEIError

PAPER = Path(__file__).parents[2] / "shared/paper"
VARIED = ["bms", "no_direction", "no_contact", "no_direction_no_contact"]
CELLS = ["PickCube-IIWA-Inspire", *(f"PickCube-IIWA-Inspire-{variant}" for variant in VARIED)]
SOURCE_CELL, RECORDING = "PickCube-Panda-PandaGripper", "PickCube, recording Panda-PandaGripper"
BROKEN = CELLS[2]
SMOKE = ["replay", "--tasks=PickCube", "--targets=IIWA-Inspire", "--episodes=1", "--seed=3", "--jobs=1"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`results` and `work` of six cells: a run in which one failed (stderr: first.txt), then another (second.txt)."""
    folder = tmp_path_factory.mktemp("benchmark")
    work = folder / "work/3-1"
    (work / CELLS[0] / "dataset").mkdir(parents=True)  # left by a run that was stopped: no obstacle
    (work / BROKEN).write_text("in the way of the cell's folder")
    for name, code in (("first", 1), ("second", 0)):
        with contextlib.redirect_stderr(io.StringIO()) as printed:
            assert command.main([*SMOKE, *folders(folder)]) == code
        (folder / f"{name}.txt").write_text(printed.getvalue())
        (work / BROKEN).unlink(missing_ok=True)
    return folder


def folders(folder: Path) -> list[str]:
    return [f"--results={folder / 'results'}", f"--work={folder / 'work'}"]


def cell_of(folder: Path, name: str) -> dict:
    return json.loads((folder / f"results/{name}.json").read_text())


def rows(folder: Path, table: str) -> list[dict[str, str]]:
    with (folder / f"{table}.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_cell_that_fails_is_named_and_leaves_the_others_intact(folder: Path) -> None:
    *progress, error, summary = (folder / "first.txt").read_text().splitlines()
    assert error.startswith(f"error: {BROKEN}: ") and f"{BROKEN}/dataset cannot be made: " in error
    assert summary == "error: 1 failed, see above; the same command runs them again."
    assert [line.split(":")[0] for line in progress] == [RECORDING, SOURCE_CELL, *CELLS]


def test_each_file_says_what_it_depends_on(folder: Path) -> None:
    manifest = Manifest.read(folder / "results")
    manifest.check()
    for name in (SOURCE_CELL, *CELLS):
        figure = manifest.figure(f"{name}.json")
        assert figure.command == "cei-benchmark replay --episodes=1 --seed=3 --tasks=PickCube --targets=IIWA-Inspire"
        assert (figure.commit, figure.seeds) == (cell_of(folder, name)["commit"], (3, 3))
        assert manifest.code[str(figure.code)]["converters/cei_converters/benchmark/jobs.py"]
    table = manifest.figure("replay.csv")
    assert table.command == "cei-benchmark replay --episodes=1 --seed=3 --redraw"
    assert all(fnmatch.fnmatch(f"{name}.json", table.made_of[0]) for name in CELLS)


def test_it_resumes_and_runs_only_what_is_missing(folder: Path) -> None:
    lines = (folder / "second.txt").read_text().splitlines()
    assert [line.split(":")[0] for line in lines] == [RECORDING, BROKEN]
    for name in (SOURCE_CELL, *CELLS):
        assert cell_of(folder, name)["replay"]["episodes"] == 1
    assert {path.name for path in (folder / "work/3-1").iterdir()} == {SOURCE_CELL}  # the others' datasets are gone


def test_nothing_runs_where_all_is_finished(folder: Path, capsys: pytest.CaptureFixture) -> None:
    start = time.perf_counter()
    assert command.main([*SMOKE, *folders(folder)]) == 0
    assert time.perf_counter() - start < 10
    assert capsys.readouterr().err == ""


def test_a_cell_says_how_it_was_made(folder: Path) -> None:
    plain, bms, no_direction, *_, neither, source = (cell_of(folder, name) for name in (*CELLS, SOURCE_CELL))
    assert (plain["task"], plain["target"], plain["variant"]) == ("PickCube", "IIWA-Inspire", "cei")
    assert (plain["options"], bms["options"]) == ([], ["--transfer.method=bms"])
    assert no_direction["options"] == ["--solver.lambda_m=0"]
    assert neither["options"] == ["--solver.lambda_m=0", "--contact.opposition_weight=0", "--contact.squeeze_m=0"]
    assert plain["seeds"] == [3, 3]
    assert plain["source_seeds"] == [3]
    assert plain["versions"]["robosuite"]
    assert plain["date"]
    assert plain["seconds"].keys() == {"convert", "replay", "stock_replay"}
    assert (plain["replay"]["stock_physics"], plain["stock_replay"]["stock_physics"]) == (False, True)
    by = [
        {each["kind"]: each["source"] for each in plain[key]["physics"]["rules"]} for key in ("replay", "stock_replay")
    ]
    assert [each["no_self_contact"] for each in by] == ["physics", "off"]
    assert "stock_replay" not in bms
    assert bms["alignment"][0]["iterations_mean"] == 0 < plain["alignment"][0]["iterations_mean"]
    assert plain["replay"]["successes"] == source["replay"]["successes"] == 1
    assert "alignment" not in source


def test_any_robot_has_a_table_without_the_paper_and_a_stopped_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arms = tmp_path / "robots/arms"
    arms.mkdir(parents=True)
    known = (Path(cei_gym.__file__).parent / "embodiment/specifications/arms/Panda.yaml").read_text()
    lines = [line for line in known.splitlines() if not line.startswith(("name:", "simulator_name"))]
    (arms / "LabArm.yaml").write_text("\n".join(["name: LabArm", *lines]) + "\n")
    monkeypatch.setenv("CEI_GYM_EMBODIMENTS", str(tmp_path / "robots"))
    robot, source = "PickCube-LabArm-PandaGripper", SOURCE_CELL
    options = ["replay", "--tasks=PickCube", "--targets=LabArm-PandaGripper", "--episodes=1", "--seed=3", "--jobs=1"]
    assert command.main([*options, *folders(tmp_path)]) == 0
    capsys.readouterr()
    (tmp_path / f"results/{robot}.json").unlink()
    assert command.main([*options, *folders(tmp_path)]) == 0
    printed = capsys.readouterr()
    assert [line.split(":")[0] for line in printed.err.splitlines()] == [RECORDING, robot]
    found = json.loads((tmp_path / "results/replay.json").read_text())
    assert (found["source"], found["seeds"]) == ("Panda-PandaGripper", [3, 3])
    assert [f"{row['task']}-{row['embodiment']}" for row in found["rows"]] == [source, robot]
    row, cell = found["rows"][1], cell_of(tmp_path, robot)
    assert (row["successes"], row["episodes"], row["interval_95"]) == (1, 1, [0.207, 1.0])
    assert row["fidelity_mean"] == pytest.approx(cell["alignment"][0]["fidelity"], abs=1e-3)
    assert row["seconds"] == pytest.approx(sum(cell["seconds"].values()), abs=0.1)
    assert len(cell["replay"]["physics"]["joints"]) == 8 and "stock_replay" not in cell
    text = (tmp_path / "results/replay.md").read_text()
    assert "| PickCube | LabArm-PandaGripper | 1 of 1 | 21% to 100% | " in text and "paper" not in text
    manifest = Manifest.read(tmp_path / "results")
    manifest.check()
    assert manifest.figure("replay.json").made_of == ("*-*-*.json",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--targets=IIWA-Inspyre",),
            "unknown target 'IIWA-Inspyre', <Arm>-<EndEffector>: unknown end-effector 'Inspyre'. Did you mean 'Inspire'? ",
        ),
        (
            ("--targets=IIWA-PandaGripper", "--tables=main"),
            "--tables=main are the paper's, which have no place for these targets",
        ),
        (("--targets=IIWA-PandaGripper", "--tasks=Fly"), "unknown task 'Fly'. Valid: OpenDrawer, PickCube, StackCube"),
        (("--targets=IIWA-PandaGripper", "--source=Me"), "unknown source 'Me', "),
        (("--source=IIWA-PandaGripper", "--tables=main"), "have no place for these targets, tasks or this source"),
        (("--tasks=PushCube", "--tables=main"), "--tables=main are the paper's, which have no place for these targets"),
    ],
)
def test_what_is_asked_of_robots_is_checked(
    options: tuple[str, ...], message: str, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    assert command.main(["replay", *options, *folders(tmp_path)]) != 0
    assert message in complaint()


def test_tasks_and_sources_that_the_paper_does_not_have_give_a_table_without_it() -> None:
    assert {"PushCube", "PlaceBird"} < {*own_tasks()} and not {*own_tasks()} & {*TASKS}
    for tasks, source in ((None, SOURCE), ("PickCube,PushCube", SOURCE)):
        assert beyond_the_paper("IIWA-Inspire", tasks, source) == beyond_the_paper(None, tasks, source) == []
    for tasks, source in (("PushCube", SOURCE), (None, "UR5e-PandaGripper")):
        assert beyond_the_paper("[IIWA-Inspire, IIWA-Inspire]", tasks, source) == ["IIWA-Inspire"]
        assert beyond_the_paper(None, tasks, source) == [*TARGETS]
    cells = robot_cells("PushCube,PickCube", ["IIWA-Inspire", "UR5e-PandaGripper"], "UR5e-PandaGripper")
    targets = ("UR5e-PandaGripper", "IIWA-Inspire")
    assert cells == [Cell(task, target) for task in ("PushCube", "PickCube") for target in targets]


def test_cells_of_several_sources_stand_in_one_table_and_are_not_taken_for_each_other(
    tmp_path: Path, complaint: Callable[[], str]
) -> None:
    placed = {"PushCube": "UR5e-PandaGripper", "PickCube": SOURCE}
    for task, source in placed.items():
        results = Results(tmp_path, range(3, 4), source)
        for target in (source, "IIWA-Inspire"):
            result = made_up(20, 20) | {"seconds": {"replay": 1.0}}
            results.write(Cell(task, target), result)
    unsaid = tmp_path / "PickCube-IIWA-Inspire.json"  # as they were made before there were other sources
    unsaid.write_text(
        json.dumps({key: value for key, value in json.loads(unsaid.read_text()).items() if key != "source"})
    )
    found = finished_robots(Results(tmp_path, range(3, 4)))
    assert {(cell.task, source_of(result)) for cell, result in found.items()} == {*placed.items()}
    text = robots_markdown(rows_of(found), ["c"])
    assert "| IIWA-Inspire | 20/20 | 20/20 |" in text and "| UR5e-PandaGripper |  | 20/20 * |" in text
    assert "of Panda-PandaGripper (PickCube) and UR5e-PandaGripper (PushCube), converted" in text
    options = ["replay", "--tasks=PushCube", "--targets=IIWA-Inspire", "--episodes=1", "--seed=3"]
    assert command.main([*options, f"--results={tmp_path}", f"--work={tmp_path / 'work'}"]) == 1
    assert "other settings (source: UR5e-PandaGripper, here Panda-PandaGripper)" in complaint()


def test_refined_cells_stand_beside_plain_ones_with_what_holds_when_shaken(tmp_path: Path) -> None:
    results = Results(tmp_path, range(3, 23), SOURCE, perturb=4)
    for target, variant, successes, share in (
        (SOURCE, "cei", 20, 1.0),
        ("IIWA-Inspire", "cei", 12, 0.5),
        ("IIWA-Inspire", "refined", 19, 0.9),
    ):
        result = made_up(successes, 20) | {"seconds": {"replay": 1.0}}
        result["replay"]["perturbed"] = {
            "replays": 4,
            "share": share,
            "interval_95": [share - 0.1, min(1, share + 0.1)],
        }
        results.write(Cell("Pick-Nut", target, variant), result)
    found = finished_robots(results)
    assert {cell.variant for cell in found} == {"cei", "refined"}
    text = robots_markdown(rows_of(found), ["c"])
    assert "| Pick-Nut | IIWA-Inspire | plain | 12 of 20 |" in text and "| 50% (40% to 60%) |" in text
    assert "| Pick-Nut | IIWA-Inspire | refined | 19 of 20 |" in text and "| 90% (80% to 100%) |" in text
    assert text.index("| plain | 12 of 20") < text.index("| refined | 19 of 20")
    assert "Perturbed is the share of 4 replays each" in text
    cells = robot_cells("Pick-Nut", ["IIWA-Inspire"], SOURCE, refine=True)
    assert [(cell.target, cell.variant) for cell in cells] == [
        *((SOURCE, "cei"), ("IIWA-Inspire", "cei")),
        ("IIWA-Inspire", "refined"),
    ]
    assert beyond_the_paper("IIWA-Inspire", "PickCube", SOURCE, refine=True) == ["IIWA-Inspire"]
    with pytest.raises(CEIError, match=r"other settings \(perturb: 4, here 0\)"):
        finished_robots(Results(tmp_path, range(3, 23), SOURCE))


def test_joints_are_those_of_a_plain_conversion(folder: Path) -> None:
    """Though clouds are cut short."""
    source = DatasetConfig("me/source", str(folder / "work/3-1" / SOURCE_CELL / "dataset"))
    converted = convert(ConvertConfig(source, "IIWA-Inspire", dry_run=True))
    assert cell_of(folder, CELLS[0])["alignment"] == converted["results"]


@pytest.mark.parametrize(("commit", "reused"), [("abc", True), ("abd", False), ("abc-dirty", False)])
def test_a_source_is_recorded_again_after_a_change_of_code(
    folder: Path, commit: str, reused: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def record(_: object) -> None:
        raise CEIError("recorded again")

    source = tmp_path / SOURCE_CELL / "dataset"
    shutil.copytree(folder / "work/3-1" / SOURCE_CELL / "dataset/meta", source / "meta")
    metadata = json.loads((source / "meta/cei.json").read_text())
    metadata["provenance"]["git_commit"] = commit.replace("abd", "abc")
    (source / "meta/cei.json").write_text(json.dumps(metadata))
    monkeypatch.setattr(jobs, "git_commit", lambda: commit)
    monkeypatch.setattr(jobs, "record", record)
    if reused:  # 4 is missing, as if the expert had failed with it
        assert jobs.record_source("PickCube", tmp_path, range(3, 5)) == [4]
    else:
        with pytest.raises(CEIError, match="recorded again"):
            jobs.record_source("PickCube", tmp_path, range(3, 5))


def test_redraw_makes_the_tables_of_what_there_is(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for path in (folder / "results").glob("*.json"):
        shutil.copy(path, tmp_path)
    assert command.main(["replay", "--redraw", "--episodes=1", "--seed=3", f"--results={tmp_path}"]) == 0
    main = {(row["arm"], row["end_effector"]): row for row in rows(tmp_path, "replay")}
    assert set(main) == {("IIWA", "Inspire"), ("Panda", "PandaGripper")}
    assert main["IIWA", "Inspire"]["paper_percent"] == "45"
    methods = {"CEI", "BMS", "without direction", "without contact", "without direction and contact"}
    assert {row["method"] for row in rows(tmp_path, "ablation")} == methods
    assert rows(tmp_path, "sensitivity") == []
    text = (tmp_path / "replay.md").read_text()
    assert "/ 45 |" in text
    assert "1 of 16" in text
    assert "PickCube" in capsys.readouterr().out
    assert Image.open(tmp_path / "heat_map.png").size[0] > 1000


@pytest.mark.parametrize(
    ("option", "code", "message"),
    [
        ("--seed=4", 1, ".json was made with other settings (seeds: [3, 3], here [4, 4]); remove it or"),
        ("--tasks=PickCub", 1, "unknown task 'PickCub'. Did you mean 'PickCube'? Valid: OpenDrawer, PickCube"),
        ("--targets=IIWA", 1, "Valid: FourierRight, Inspire, FourierLeft"),
        ("--tables=man", 1, "unknown table 'man'. Did you mean 'main'? Valid: main, ablation, sensitivity."),
        ("--tables=sensitivity --tasks=StackCube", 1, "It has: PickCube; UR5e-FourierRight."),
        ("--jobs=0", 2, "--jobs=0 should be at least 1."),
        ("--results=nowhere --redraw", 1, "no cell is finished in nowhere."),
    ],
)
def test_bad_input_is_one_clear_line(folder: Path, option: str, code: int, message: str, complaint: Callable) -> None:
    given = [other for other in folders(folder) if other.partition("=")[0] not in option]
    assert command.main(["replay", "--episodes=1", *given, *option.split()]) == code
    assert message in complaint()


def test_an_unknown_benchmark_lists_the_valid_ones(capsys: pytest.CaptureFixture) -> None:
    assert command.main(["polcy"]) == 2
    assert (
        capsys.readouterr().err
        == "error: unknown benchmark 'polcy'. Did you mean 'policy'? Valid: anchors, modes, policy, real, replay, results.\n"
    )


def test_help_names_the_benchmarks(capsys: pytest.CaptureFixture) -> None:
    assert command.main([]) == command.main(["--help"]) == 0
    assert "replay" in capsys.readouterr().out


@pytest.mark.parametrize("content", ["{", "[]", "{}"])
def test_a_strange_file_is_named(content: str, tmp_path: Path) -> None:
    (tmp_path / "PickCube-IIWA-Inspire.json").write_text(content)
    with pytest.raises(CEIError, match=r"PickCube-IIWA-Inspire\.json"):
        Results(tmp_path, range(3, 4)).read_all()


# -- what there is to run, and the paper's figures ----------------------------------------------------------------


def test_cells_are_those_of_the_papers_tables() -> None:
    assert len(TABLES["main"]) == 3 * (16 + 1)
    assert len(TABLES["ablation"]) == 3 * 4 * 5
    assert len(TABLES["sensitivity"]) == 3
    assert len([cell for cell in all_cells() if cell.task in TASKS]) == 51 + 3 * 4 * 4 + 2


@pytest.mark.skipif(not PAPER.exists(), reason="needs ../shared/paper")
def test_the_papers_figures_are_the_papers() -> None:
    names = {"FourierRightHand": "FourierRight", "InspireRightHand": "Inspire", "FourierLeftHand": "FourierLeft"}
    with (PAPER / "replay_success.csv").open() as file:
        for row in csv.DictReader(file):
            figures = paper.REPLAY[row["task"]][names.get(row["end_effector"], row["end_effector"])]
            assert figures == {arm: int(row[arm.lower()]) for arm in ARMS}
    with (PAPER / "replay_ablation.csv").open() as file:
        for task, method, *figures, _ in list(csv.reader(file))[1:]:
            assert paper.ABLATION[task][method.removeprefix("CEI ")] == tuple(map(int, figures))
    with (PAPER / "representation_sensitivity.csv").open() as file:
        for representation, success in list(csv.reader(file))[1:]:
            assert paper.SENSITIVITY[representation.lower()] == 5 * int(success.removesuffix("/20"))


# -- tables and picture, of made-up cells -------------------------------------------------------------------------


def made_up(successes: int, stock: int) -> dict:
    replay = {"episodes": 20, "interval_95": [0, 1], "failures": {}}
    return {
        "commit": "c",
        "replay": replay | {"successes": successes},
        "stock_replay": replay | {"successes": stock},
    }


def test_the_papers_tables_say_what_holds_when_shaken() -> None:
    found = {Cell("StackCube", target): made_up(20, 20) for target in ("UR5e-FourierRight", "IIWA-Inspire")}
    assert "Slightly otherwise" not in markdown(found)
    for result, share in zip(found.values(), (0.9, 0.7), strict=True):
        result["replay"]["perturbed"] = {"replays": 4, "share": share, "interval_95": [0.5, 1.0]}
    text = markdown(found)
    assert "Percent of 4 replays of each demonstration" in text and "| StackCube | 2 of 16 | 80 | 70 |" in text


def test_averages_compare_with_the_paper_over_the_same_cells() -> None:
    found = {Cell("PickCube", "UR5e-FourierRight"): made_up(20, 10), Cell("PickCube", "IIWA-Inspire"): made_up(10, 0)}
    assert averages(found, "PickCube") == (75, 25, (81 + 45) / 2)
    assert averages(found, "StackCube") == (None, None, None)
    text = markdown(found)
    assert "| PickCube | 75 | 25 | 63 | 2 of 16 | - |" in text
    assert "| FourierRight | 100 / 50 / 81 | - / - / 72 |" in text
    assert "| PickCube | without contact | - / - | - / - | - / - | - / - | - / - |" in text
    assert "| PickCube | CEI | 100 / 81 | 50 / 45 | - / 81 | - / 52 | - / 65 |" in text
    assert "| PickCube, UR5e-FourierRight | 100 / 85 | - / 90 | - / 80 |" in text
    assert shown(94.5) == "95"  # as the paper rounds


def test_the_heat_map_frames_what_is_below_the_paper_and_leaves_missing_cells_blank(tmp_path: Path) -> None:
    cells = [Cell(task, f"{arm}-{end_effector}") for task in TASKS for end_effector in END_EFFECTORS for arm in ARMS]

    def drawn(found: dict[Cell, dict]) -> np.ndarray:
        write_heat_map(found, tmp_path / "map.png")
        return np.asarray(Image.open(tmp_path / "map.png").convert("RGB")).astype(int)

    def red(picture: np.ndarray) -> int:
        return int(((picture[..., 0] > 180) & (picture[..., 1] < 80) & (picture[..., 2] < 80)).sum())

    def blue(picture: np.ndarray) -> int:
        return int((picture[..., 2] - picture[..., 0] > 60).sum())

    good, bad, none = (
        drawn(found)
        for found in (
            {c: made_up(20, 20) for c in cells},
            {c: made_up(20, 20) for c in cells} | {cells[0]: made_up(1, 1)},
            {},
        )
    )
    assert red(good) == red(none) == blue(none) == 0
    assert red(bad) > 500
    assert blue(good) > 40 * 10_000


# -- parallel processes -------------------------------------------------------------------------------------------


def test_jobs_follow_their_first_one_only_if_it_succeeds() -> None:
    follower = Job("follower", len, ("ab",))
    jobs = [Job("good", len, ("a",), (follower,)), Job("bad", int, ("x",), (Job("never", len, ("",)),))]
    outcomes = {outcome.job.name: outcome for outcome in run_jobs(jobs, 2)}
    assert outcomes.keys() == {"good", "follower", "bad"}
    assert outcomes["follower"].result == 2
    assert "ValueError: invalid literal" in (outcomes["bad"].error or "")


def test_closing_stops_what_runs_at_once() -> None:
    runs = run_jobs([Job("short", len, ("a",)), Job("long", time.sleep, (60,))], 2)
    start = time.perf_counter()
    with contextlib.closing(runs):
        assert next(runs).job.name == "short"
    assert time.perf_counter() - start < 30
    assert not multiprocessing.active_children()


def test_a_worker_that_dies_is_an_error_not_a_wait() -> None:
    with pytest.raises(CEIError, match="a worker died"):
        list(run_jobs([Job("dies", os._exit, (1,))], 1))


ORPHANS = """
import time
from pathlib import Path
from cei_converters.benchmark.runner import Job, run_jobs
runs = run_jobs([Job("pid", Path("pid").write_text, ("x",)), Job("long", time.sleep, (60,))], 1)
next(runs)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_what_started_them(number: int, tmp_path: Path) -> None:
    code = f"if __name__ == '__main__':\n{textwrap.indent(ORPHANS.strip(), '    ')}\n    print('waits', flush=True)\n    time.sleep(60)\n"
    (tmp_path / "main.py").write_text(code)
    process = subprocess.Popen([sys.executable, "main.py"], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "waits\n"
    os.kill(process.pid, number)
    start = time.monotonic()
    assert process.stdout.read() == ""  # its workers have it open, too
    process.wait()
    assert time.monotonic() - start < 20
