"""A dataset's frames are said to be one period apart, but a simulation's steps wait for joints: how long each took is said, to the figure."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conversions import record_cubes, records
from rollouts import make

from cei_converters import convert, replay
from cei_converters.dataset.metadata import Metadata
from cei_converters.dataset.step_time import STEP_TIMES, StepTime, StepTimes
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.inspection import command as inspecting
from cei_converters.sources.reader import DatasetReader
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError

ROBOT, SEED = "Panda-PandaGripper", 3
TRUE = {"robot": ROBOT, "each": [0.05, 0.1, 0.05, 0.25], "at_most": 0.25}


@pytest.fixture(scope="module")
def waiting(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("time") / "waiting"
    record_cubes(root, 1, SEED)
    return root


@pytest.fixture(scope="module")
def fixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("time") / "fixed"
    record_cubes(root, 1, SEED, "--fixed_rate")
    return root


def clock(root: Path) -> list[float]:
    """What the simulation's own clock says that each recorded step takes, s."""
    reader = DatasetReader("me/any", root)
    assert reader.metadata is not None
    env, recorded, times = make("PickCube", ROBOT, **reader.metadata.environment.kwargs), reader.read(0), []
    assert recorded.environment_state is not None
    env.reset(options={"environment_state": recorded.environment_state[0], "agent_pos": recorded.qpos[0]})
    for action in recorded.action:
        before = env.simulation.data.time
        env.step(action.astype(np.float32))
        times.append(env.simulation.data.time - before)
    env.close()
    return times


def test_what_is_recorded_is_what_the_simulations_clock_says(waiting: Path) -> None:
    (record,) = records(waiting)
    found, times = StepTimes.of(record), clock(waiting)
    assert found is not None and (found.robot, found.at_most) == (ROBOT, 0.25)
    np.testing.assert_allclose(found.each, times, atol=1e-9)
    said = Metadata.load(waiting).step_time_s
    assert said is not None and (said.robots, said.steps, said.at_most) == ((ROBOT,), len(times), 0.25)
    assert said.mean == pytest.approx(np.mean(times)) and said.max == pytest.approx(max(times))
    assert said.in_time == np.mean(np.array(times) < 0.051)
    assert 0.3 < said.in_time < 0.7 and said.waits  # about half of the steps wait


def test_at_a_fixed_rate_frames_are_as_far_apart_as_is_said(fixed: Path) -> None:
    np.testing.assert_allclose(clock(fixed), 1 / 20, atol=1e-9)
    metadata = Metadata.load(fixed)
    assert metadata.environment.kwargs["max_hold_ticks"] == 1  # so it replays, converts and is evaluated likewise
    said = metadata.step_time_s
    assert (
        said is not None
        and not said.waits
        and (said.in_time, said.mean, said.max, said.at_most)
        == (
            1,
            *[0.05] * 3,
        )
    )
    assert "took 0.05 s, as 20 frames a second say" in (fixed / "README.md").read_text()


def test_it_is_said_in_plain_words(waiting: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    known = Metadata.load(waiting).step_time_s
    assert known is not None
    words = known.sentence(20)
    assert words.startswith(f"Frames are said to be 0.05 s apart (20 a second); in simulation a step of {ROBOT} took ")
    assert f"up to {known.max:.3g} s" in words and f"in {100 * known.in_time:.0f} %" in words
    assert f"## Time\n\n{words}" in (waiting / "README.md").read_text()
    dataset = ("--dataset.repo_id=me/any", f"--dataset.root={waiting}")
    for main, more in ((inspecting.main, ()), (replay.main, ("--video_episodes=0",))):
        assert main([*dataset, *more, f"--json={tmp_path / main.__module__}.json"]) == 0
        assert words in capsys.readouterr().out.splitlines()
        assert json.loads((tmp_path / f"{main.__module__}.json").read_text())["step_time_s"]["steps"] == known.steps


def write(root: Path, times: dict[str, Any], frames: int = 12) -> None:
    """A Panda that turns faster than its target can."""
    qpos = np.tile(load_embodiment(ROBOT).home, (frames, 1))
    qpos[:, 0] += 0.1 * np.maximum(np.arange(frames) - 4, 0)
    scene = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))
    with DatasetWriter("me/pick", root) as writer:
        writer.add(Demonstration(ROBOT, 20.0, qpos, qpos, scene), {STEP_TIMES: times})


def converted(root: Path, out: Path) -> dict[str, Any]:
    args = ["--dataset.repo_id=me/pick", f"--dataset.root={root}", "--target=IIWA-PandaGripper", "--workers=1"]
    quick = ["--init.starts=8", "--init.basins=1", "--allow_unreachable", "--new_repo_id=me/out", f"--new_root={out}"]
    assert convert.main([*args, *quick]) == 0
    (record,) = records(out)
    return record


def test_a_conversion_has_the_time_of_the_step_that_each_frame_is_of(tmp_path: Path) -> None:
    each = [0.05 * (1 + t % 5) for t in range(12)]
    write(tmp_path / "source", {"robot": ROBOT, "each": each, "at_most": 0.25})
    record = converted(tmp_path / "source", tmp_path / "out")
    assert len(record["source_frames"]) > 12  # it had to wait
    assert record[STEP_TIMES]["each"] == [each[frame] for frame in record["source_frames"]]
    said = Metadata.load(tmp_path / "out").step_time_s
    assert said is not None and (said.robots, said.steps) == ((ROBOT,), len(record["source_frames"]))
    assert "IIWA-PandaGripper was not timed" in (tmp_path / "out/README.md").read_text()


def test_times_of_other_frames_are_not_believed(tmp_path: Path) -> None:
    write(tmp_path / "source", TRUE)  # of four frames, where there are twelve
    assert STEP_TIMES not in converted(tmp_path / "source", tmp_path / "out")
    assert Metadata.load(tmp_path / "out").step_time_s is None
    assert "## Time" not in (tmp_path / "out/README.md").read_text()


def test_figures_of_some_steps() -> None:
    other = {"robot": "IIWA-Inspire", "each": [0.05] * 15 + [0.3], "at_most": None}
    assert StepTime.of([{}, {STEP_TIMES: TRUE}], 20) == StepTime((ROBOT,), 4, 0.5, 0.1125, 0.1, 0.25, 0.25, 0.25)
    both = StepTime.of([{STEP_TIMES: TRUE}, {STEP_TIMES: other}], 20)
    assert both == StepTime((ROBOT, "IIWA-Inspire"), 20, 0.85, 0.075, 0.05, 0.3, 0.3, None)
    ten = StepTime.of([{STEP_TIMES: TRUE}], 10)  # at a slower rate most of them are in time
    assert ten is not None and ten.in_time == 0.75
    assert StepTime.of([{}, {"seed": 3}], 20) is None


@pytest.mark.parametrize(
    "change",
    [
        {"each": []},
        {"each": [0.05, "x"]},
        {"each": [0.05, True]},
        {"each": [0.05, 0.0]},
        {"each": [0.05, math.inf]},
        {"each": 0.05},
        {"at_most": "x"},
        {"at_most": -1},
        {"robot": 3},
        {"more": 3},
    ],
    ids=str,
)
def test_a_strangers_record_that_cannot_be_is_as_none(change: dict[str, Any]) -> None:
    assert StepTimes.of({STEP_TIMES: TRUE}) is not None
    assert StepTimes.of({STEP_TIMES: TRUE | change}) is None
    assert StepTimes.of({STEP_TIMES: [0.05]}) is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mean": None}, "times above 0"),
        ({"mean": 0.0}, "times above 0"),
        ({"p95": "x"}, "step_time_s"),
        ({"in_time": 1.5}, "a share in_time"),
        ({"steps": 0}, "times above 0"),
        ({"robots": [None]}, "robots should be names"),
        ({"colour": 3}, "colour"),
    ],
    ids=str,
)
def test_what_strangers_say_in_metadata_is_checked(waiting: Path, change: dict[str, Any], said: str) -> None:
    raw = json.loads((waiting / "meta/cei.json").read_text())
    older = {key: value for key, value in raw.items() if key != "step_time_s"}
    assert Metadata.decode(older, "here").step_time_s is None
    with pytest.raises(CEIError, match=f"^here.*{said}"):
        Metadata.decode(raw | {"step_time_s": raw["step_time_s"] | change}, "here")
    with pytest.raises(CEIError, match=f"^there.*{said}"):
        StepTime.decode(raw["step_time_s"] | change, "there")
    for wrong in ("slow", [3], 3):
        with pytest.raises(CEIError, match=r"^here"):
            Metadata.decode(raw | {"step_time_s": wrong}, "here")
