"""The alignment's benchmarks run, on next to nothing, and write what they promise."""

import contextlib
import io
import json
import runpy
from pathlib import Path
from unittest.mock import ANY

import numpy as np
import pytest
from PIL import Image

from cei_converters.benchmark.figures import Figure, Manifest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
ROBOTS = BENCHMARKS.parents[1] / "shared/robots"


def run(script: str, tmp_path: Path, *args: str) -> str:
    """What a script prints. It runs in this process, which has imported what it needs; all that it changes there is put back."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as printed:
        patch.chdir(tmp_path)
        patch.syspath_prepend(BENCHMARKS)
        patch.setattr("sys.argv", [script, "--results", str(tmp_path / "results"), *args])
        runpy.run_path(str(BENCHMARKS / script), run_name="__main__")
    return printed.getvalue()


def depends_on(tmp_path: Path, *names: str) -> Figure:
    """What is said of files, which were made together, and are all that there is."""
    manifest = Manifest.read(tmp_path / "results")
    manifest.check()
    assert manifest.names() == [*names]
    (figure,) = {manifest.figure(name).command: manifest.figure(name) for name in names}.values()
    assert figure.commit
    assert figure.code in manifest.code
    return figure


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="third-party descriptions are not in ../shared/robots")
def test_census(tmp_path: Path) -> None:
    printed = run("census.py", tmp_path, "--sets", "shared")
    result = json.loads((tmp_path / "results/census.json").read_text())
    assert result["counts"]["shared"] == {"right": 24, "refused": 1, "altered": 0, "not compared": 0}
    assert "refused: shared, shadow_hand/bimanual.urdf: bimanual.urdf: no such file: 'meshes/visual/" in printed
    assert depends_on(tmp_path, "census.json").command == "python benchmarks/census.py --sets shared"
    assert str(ROBOTS) not in (tmp_path / "results/census.json").read_text()


def test_what_is_otherwise_than_in_its_file_is_found(tmp_path: Path) -> None:
    urdf = """<robot name="r"><link name="base"/><link name="tip"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0"
        ixz="0" iyz="0"/></inertial><collision><geometry><box size="0.1 0.1 {}"/></geometry></collision></link>
        <joint name="j" type="revolute"><origin xyz="0 0 {}"/><parent link="base"/><child link="tip"/><limit lower="-1" upper="{}"/></joint>
        </robot>"""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        census = runpy.run_path(str(BENCHMARKS / "census.py"))
    path = tmp_path / "arm.urdf"
    path.write_text(urdf.format(0.2, 0.5, 1))
    body = census["load"](path)
    assert [*census["altered"](path, body)] == []
    for numbers, message in (
        ((0.3, 0.5, 1), "reaches 50.0 mm"),
        ((0.2, 0.6, 1), "100.0 mm off"),
        ((0.2, 0.5, 2), "limits"),
    ):
        path.write_text(urdf.format(*numbers))
        (found,) = census["altered"](path, body)
        assert message in found


def test_start_up(tmp_path: Path) -> None:
    printed = run("start_up.py", tmp_path, "Panda-PandaGripper", "--repeats=1")
    row = json.loads((tmp_path / "results/start_up.json").read_text())["robots"]["Panda-PandaGripper"]
    assert row["later"]["processor"] < row["first"]["processor"]  # kernels are compiled once
    for seconds in row.values():
        assert sum(seconds[stage] for stage in ("import", "make", "reset")) <= seconds["total"] + 0.05
    assert f"{row['later']['total']:.1f}" in printed
    assert (
        depends_on(tmp_path, "start_up.json").command == "python benchmarks/start_up.py Panda-PandaGripper --repeats=1"
    )


def test_alignment(tmp_path: Path) -> None:
    run("alignment.py", tmp_path, "UR5e-RobotiqThreeFinger", "--demonstrations=1", "--frames=3", "--pairs=16")
    result = json.loads((tmp_path / "results/speed_lambda_0.05.json").read_text())
    rows = {(row["method"], row["threads"]): row for row in result["methods"]}
    ours, papers = rows["ours", 1], [row for (name, _), row in rows.items() if name.startswith("paper")]
    assert len(papers) == 4  # three learning rates, and the best with all threads
    assert (
        ours["objective_mean_m"] < min(row["objective_mean_m"] for row in papers) + 2e-3
    )  # so few pairs have many minima
    assert ours["ms_per_frame"] < min(row["ms_per_frame"] for row in papers)
    assert [row["demonstrations"] for row in result["scaling"]] == [1, 25, 100, 400]
    assert len(result["floor"]) == len(result["live"]) == 1
    assert (tmp_path / "results/speed_lambda_0.05.png").stat().st_size > 10_000
    assert (tmp_path / "results/speed_lambda_0.05.csv").read_text().count("\n") == len(result["methods"]) + 1
    figure = depends_on(tmp_path, *(f"speed_lambda_0.05.{suffix}" for suffix in ("csv", "json", "png")))
    assert figure.seeds == (0, 0)
    assert "benchmarks/others.py" in figure.measures


def test_impersonation(tmp_path: Path) -> None:
    """A real cube, in physics: the Panda's expert knows nothing of the hand that lifts it."""
    printed = run("impersonation.py", tmp_path, "--target=IIWA-FourierRight", "--seed=20", "--episodes=3")
    result = json.loads((tmp_path / "results/PickCube-IIWA-FourierRight.json").read_text())
    assert result["successes"] >= 2  # all do here; what is left to chance is another CPU's BLAS
    assert printed.startswith(f"{result['successes']} of 3 succeed")
    assert 0 < result["wrapper_ms"]["50"] <= result["wrapper_ms"]["99"]


def test_observation(tmp_path: Path) -> None:
    run("observation.py", tmp_path, "--repeats=2")
    result = json.loads((tmp_path / "results/observation.json").read_text())
    masks = [row for row in result["rows"] if row["step"] == "mask"]
    assert {(row["view"], row["points"]) for row in masks} == {
        (v, p) for v in ("task", "close-up") for p in (4800, 19200)
    }
    for row in masks:
        assert row["missed"]["ours"] <= 0.01 * row["on_the_robot"] < row["missed"]["obvious"]
    assert set(result["control_period_ms"]) == {"environment", "with CrossEmbodimentWrapper"}


def test_first_frame(tmp_path: Path) -> None:
    printed = run("first_frame.py", tmp_path, "--cases=2", "--seed=0")
    assert "multistart" in printed
    result = json.loads((tmp_path / "results/first_frame.json").read_text())
    assert result["cases"] == 2
    assert result["methods"]["multistart"]["found_percent"] == 100
    figure = depends_on(tmp_path, "first_frame.json")
    assert figure.command == "python benchmarks/first_frame.py --cases=2 --seed=0"
    assert figure.seeds == (0, 1)


def test_twin(tmp_path: Path) -> None:
    printed = run("twin.py", tmp_path, "--things=Cube", "--targets=IIWA-Inspire", "--seeds=3")
    rows = json.loads((tmp_path / "results/twin.json").read_text())["rows"]
    assert [(row["depth"], row["seed"], row["way"]) for row in rows] == [
        *(("clean", 3, "plain"), ("clean", 3, "off"), ("kinect", 503, "plain"), ("kinect", 503, "off"))
    ]
    assert rows[0]["truth"] and rows[0]["answer"] == "holds"
    assert f"| all | 4 | {sum(not row['truth'] for row in rows)} |" in printed
    assert depends_on(tmp_path, "twin.json").seeds == (3, 503)


def test_things(tmp_path: Path) -> None:
    run("things.py", tmp_path, "--things=Sphere", "--targets=IIWA-Inspire", "--seeds=1")
    shown = json.loads((tmp_path / "results/things.json").read_text())["shown"]
    assert shown == {"Sphere": {"succeeds": "IIWA-Inspire, seed 0: succeeds"}}
    assert depends_on(tmp_path, "things.json", "things.png").seeds == (0, 0)
    picture = np.asarray(Image.open(tmp_path / "results/things.png").convert("RGB"))
    filmed, none = np.split(picture[:, 110:], 2, axis=1)
    assert (filmed != 255).any(axis=2).mean() > 0.8 > 0.1 > (none != 255).any(axis=2).mean()


def test_score(tmp_path: Path) -> None:
    """Where answers are always right but for one, of an object and a robot that has another."""
    rows = [
        {"thing": thing, "target": target, "seed": seed, "truth": works, "shaken": [works] * 3}
        | {"answer": "holds" if works or (thing, target, seed) == ("Can", "A", 1) else "fails"}
        for thing in ("Can", "Cube")
        for target in ("A", "B")
        for seed, works in enumerate((True, False) * 4)
    ]
    (tmp_path / "twin.json").write_text(json.dumps({"rows": rows}))
    (tmp_path / "fresh.json").write_text(json.dumps({"rows": rows[:8]}))
    printed = run("score.py", tmp_path, f"--fit={tmp_path / 'twin.json'}", f"--judged={tmp_path / 'fresh.json'}")
    assert "| other seeds | 8 | 4 | 8 |" in printed
    result = json.loads((tmp_path / "results/score.json").read_text())
    assert result["worked"] == {"holds": [16, 17], "unsure": [0, 0], "fails": [0, 15]}
    assert result["held_out"]["other seeds"]["auc"] == pytest.approx((4 * 3 + 4 * 0.5) / 16, abs=1e-3)
    assert result["held_out"]["other objects"]["kept_at_0.8"] == {"works": 16, "of": 17, "interval_95": ANY}
    assert (tmp_path / "results/reliability.png").exists()
    assert depends_on(tmp_path, "reliability.png", "score.json").seeds == (0, 7)


def test_live_pictures(tmp_path: Path) -> None:
    run("live_pictures.py", tmp_path, "--tasks=PickCube", "--targets=IIWA-Inspire", "--seeds=3")
    (row,) = json.loads((tmp_path / "results/live.json").read_text())["table"]
    assert row["whole"] < 0.015 < row["unpainted"]
    assert row["successes"] == 1
    assert depends_on(tmp_path, "live.json", "live.png").seeds == (3, 3)


def test_image_policy(tmp_path: Path) -> None:
    few = "--demonstrations=1", "--steps=2", "--batch_size=2", "--episodes=1", "--seed=3"
    printed = run("image_policy.py", tmp_path, "--arms=true", *few, f"--work={tmp_path / 'work'}")
    assert "true 0 of 1" in printed
    found = json.loads((tmp_path / "results/image_policy.json").read_text())["arms"]
    assert found == {arm: {"successes": 0, "trials": 1} for arm in ("true", "blind")}


def test_pictures(tmp_path: Path) -> None:
    run("pictures.py", tmp_path, "--tasks=PickCube", "--targets=IIWA-Inspire", "--seeds=3")
    (row,) = json.loads((tmp_path / "results/pictures.json").read_text())["table"]
    assert row["whole"] < 0.005 < 0.05 < row["unpainted"]
    assert (tmp_path / "results/pictures.png").exists()
    assert depends_on(tmp_path, "pictures.json", "pictures.png").seeds == (3, 3)


def test_camera_fit(tmp_path: Path) -> None:
    printed = run("camera_fit.py", tmp_path, "--starts=1", "--far=0.01,1,0.01")
    assert "1 of 1 within 1 pixel, 0 refused" in printed
    (row,) = json.loads((tmp_path / "results/camera_fit.json").read_text())["rows"]
    assert row["off_px"] < 1 < row["began_px"]


def test_a_blind_control_has_its_folders_seeds(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    Manifest(tmp_path / "results", [Figure(("a.json",), "cei-benchmark replay", seeds=(3, 5))]).write()
    with pytest.raises(SystemExit, match="has cells of seeds 3-5, not 4-6"):
        run("blind_control.py", tmp_path, "--seed=4", "--episodes=3")
    Manifest(tmp_path / "results").write()
    assert run("blind_control.py", tmp_path, "--seed=4", "--episodes=2") == "blind control: 0 of 2 succeed\n"
    assert depends_on(tmp_path, "blind_control.json").seeds == (4, 5)
