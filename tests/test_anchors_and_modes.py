"""`cei-benchmark anchors` and `modes` through the real command, on next to nothing, and what they ask of environments and conversions."""

import json
import pickle
import time
from collections.abc import Callable
from pathlib import Path

import draccus
import gymnasium as gym
import numpy as np
import pytest
from PIL import Image
from third_party import needs_robots

import cei_gym  # noqa: F401  (registers the environments)
from cei_converters.benchmark import anchors_picture, anchors_report, command, modes_report, paper
from cei_converters.benchmark.anchors_stages import ANCHORS, Anchor
from cei_converters.benchmark.figures import Manifest
from cei_converters.benchmark.modes_stages import PATTERNS, ModeStages, Pattern
from cei_converters.benchmark.policy_stages import Training, Trials
from cei_converters.cli import parse
from cei_converters.conversion.config import ConvertConfig
from cei_converters.dataset.records import Records
from cei_converters.simulation.environment import check_arguments
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from lerobot_env_cei import CEIEnvConfig

TINY = ["--jobs=1", "--episode_length=6", "--training.steps=2", "--training.batch_size=4", "--training.points=32"]
ONE_ANCHOR = ["anchors", "--anchors=9", "--grid=2", "--trials=2", *TINY]
ONE_PATTERN = ["modes", "--patterns=pattern_2", "--episodes=1", "--demonstrations=1", "--trials=1", *TINY]
BUTTON = "CEI-PressButton-Panda-PandaGripper"
CONVERT = ["--dataset.repo_id=me/any", "--target=UR5e-Inspire", "--dry_run"]


@pytest.fixture(scope="module")
def anchors(third_party_robots: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`results` and `work` of one anchor: replayed, trained, tried."""
    folder = tmp_path_factory.mktemp("anchors")
    assert command.main([*ONE_ANCHOR, *places(folder), "--stage=evaluate"]) == 1  # nothing is trained yet
    assert command.main([*ONE_ANCHOR, *places(folder), "--stage=train"]) == 0
    assert not [*folder.glob("results/*")]
    assert command.main([*ONE_ANCHOR, *places(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def modes(third_party_robots: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`results` and `work` of one demonstration: replayed in both motions, one of them learnt."""
    folder = tmp_path_factory.mktemp("modes")
    assert command.main([*ONE_PATTERN, *places(folder), "--stage=replay"]) == 0
    assert command.main([*ONE_PATTERN, *places(folder)]) == 0
    return folder


def places(folder: Path) -> list[str]:
    return [f"--results={folder / 'results'}", f"--work={folder / 'work'}"]


def found(folder: Path, name: str) -> dict:
    return json.loads((folder / f"results/{name}.json").read_text())


def check_resumes(folder: Path, args: list[str]) -> None:
    """The same command again does nothing."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*_*.json")}
    start = time.perf_counter()
    assert command.main([*args, *places(folder)]) == 0
    assert command.main([*(each for each in args if each != "--jobs=1"), *places(folder), "--redraw"]) == 0
    assert time.perf_counter() - start < 10
    assert {path: path.stat().st_mtime_ns for path in before} == before


# -- anchors -----------------------------------------------------------------------------------------------------------


@needs_robots
def test_one_demonstration_is_made_four_around_an_anchor_and_replayed_there(anchors: Path) -> None:
    result, (x, y) = found(anchors, "anchors_replay"), ANCHORS[8]
    assert (x, y) == (0.0, 0.2)
    assert (result["demonstration"], result["grid"], result["anchors"], result["made"]) == (0, 2, [[x, y]], [4])
    assert [each["success"] for each in result["episodes"]] == [True, True]
    stood = [(each["x_m"], each["y_m"]) for each in result["episodes"]]  # from the first of the grid to the last
    np.testing.assert_allclose(stood, [(x - 0.08, y - 0.08), (x + 0.08, y + 0.08)], atol=1e-3)
    [made] = anchors.glob("work/anchors-0-2-9/datasets/*-swapped")
    assert len(Records(made)) == 4


@needs_robots
def test_the_policy_is_tried_around_the_anchor_where_it_says(anchors: Path) -> None:
    result = found(anchors, "anchors_9")
    assert (result["successes"], result["source_seeds"], result["number"]) == ([False, False], [0], 9)
    assert result["trials"] == {"first_seed": 2000, "count": 2, "length": 6}
    env = gym.make("CEI-PressButton-UR5e-XHand", middle_m=ANCHORS[8], clouds=False)
    for seed, place in zip((2000, 2001), result["places"], strict=True):
        np.testing.assert_allclose(env.reset(seed=seed)[0]["environment_state"][:3], place, atol=1e-4)
    env.close()
    log = next(anchors.glob("work/anchors-0-2-9/evaluated/anchors_9.log")).read_text()
    assert "middle_m" in log and "0.2" in log


@needs_robots
def test_anchors_are_a_table_and_a_map_that_say_what_they_depend_on(anchors: Path) -> None:
    text = (anchors / "results/anchors.md").read_text()
    assert "| 9 | 0 | 20 | 4 | 2 of 2 | 0 of 2 | - |" in text and "| **all** |  |  | 4 | 2 of 2 | 0 of 2 |" in text
    assert "gives no number in its text" in text
    assert found(anchors, "anchors")["anchors"][8]["policy"] == {"successes": 0, "of": 2}
    assert np.asarray(Image.open(anchors / "results/anchors.png")).std() > 5
    manifest = Manifest.read(anchors / "results")
    manifest.check()
    said = "--demonstration" not in manifest.figure("anchors.md").command
    assert said and manifest.figure("anchors.md").command.endswith(" --redraw")
    assert manifest.figure("anchors_9.json").command.startswith("cei-benchmark anchors --stage=policy --anchors=9")
    assert "policies/lerobot_policy_dp3/*" in manifest.figure("anchors_9.json").measures
    assert "policies/lerobot_policy_dp3/*" not in manifest.figure("anchors_replay.json").measures
    assert not [*(anchors / "results").glob("*-*-*.json")]  # those are of `cei-benchmark real`


@needs_robots
def test_anchors_resume_and_refuse_other_settings(anchors: Path, complaint: Callable[[], str]) -> None:
    check_resumes(anchors, ONE_ANCHOR)
    for option, said in (
        ("--grid=3", "made with other settings (grid: 2, here 3); remove it or choose"),
        ("--demonstration=4", "other settings (demonstration: 0, here 4)"),
        ("--anchors=9,10", "other settings (anchors: [[0.0, 0.2]], here [[0.0, 0.2], [0.0, 0.4]])"),
        ("--training.lr=0.5", "other settings (training: "),
    ):
        options = [each for each in ONE_ANCHOR if each.partition("=")[0] != option.partition("=")[0]]
        assert command.main([*options, *places(anchors), option]) == 1
        assert said in complaint()


def test_a_map_shows_what_fails(tmp_path: Path) -> None:
    anchor = Anchor(number=1)
    shared = {"task": "PressButton", "source": "A", "target": "B", "demonstration": 0, "grid": 10, "range_m": 0.16}
    shared |= {"anchors": [[*each] for each in ANCHORS], "base_m": [-0.56, 0.0], "commit": "c"}
    episodes = [{"anchor": 1, "x_m": -0.2, "y_m": -0.4, "success": False, "failure": "not through"}]
    replayed = shared | {"made": [99] + [100] * 9, "episodes": episodes}
    policy = shared | {"successes": [True, False], "places": [[-0.2, -0.4, 0], [-0.15, -0.45, 0]]}
    policy |= {"trials": {"count": 2, "first_seed": 2000}}
    all_found = anchors_report.Found(replayed, {anchor: policy})
    text = anchors_report.write_report(all_found, tmp_path)
    assert "becomes 1000 of B" in text and "each of 10 anchors" in text
    assert "| 1 | -20 | -40 | 99 | 0 of 1 | 1 of 2 | not through: 1 |" in text
    for some in (all_found, anchors_report.Found(None, {anchor: policy}), anchors_report.Found(replayed, {})):
        anchors_picture.draw(some, tmp_path / "map.png")
        assert np.asarray(Image.open(tmp_path / "map.png")).std() > 5


# -- modes -------------------------------------------------------------------------------------------------------------


@needs_robots
def test_both_motions_of_a_demonstration_succeed_and_differ_in_the_hand(modes: Path) -> None:
    result = found(modes, "modes_replay")
    assert (result["seeds"], result["source_seeds"]) == ([2000, 2000], [2000])
    assert result["options"] == ["--init=eis", "--init.modes=2"]
    assert [each["successes"] for each in result["patterns"].values()] == [1, 1]
    assert np.min(result["angles_deg"]) > 90
    left, right = np.split(np.asarray(Image.open(modes / "results/modes.png")).astype(int), [642], axis=1)
    assert min(left.std(), right.std()) > 10 and abs(left[:, :640] - right[:, -640:]).mean() > 3


@needs_robots
def test_one_of_the_motions_is_learnt(modes: Path) -> None:
    result = found(modes, "modes_pattern_2")
    assert (result["variant"], result["successes"], result["source_seeds"]) == ("pattern_2", [False], [0])
    assert result["options"] == ["--init=eis", "--init.modes=2", "--init.mode=1"]
    assert [path.name for path in modes.glob("work/trained/*-0")] == [
        "OpenDrawer-UR5e-XHand-of-UR5e-AG95-swapped-pattern_2-0"
    ]
    text = (modes / "results/modes.md").read_text()
    assert (
        "| pattern 2 | 1 of 1 | 0 of 1 | 0% to 79% | 7 of 10 |" in text and "| mixture | - | - | - | 7 of 10 |" in text
    )
    manifest = Manifest.read(modes / "results")
    manifest.check()
    assert manifest.figure("modes.png") == manifest.figure("modes_replay.json")
    assert "policies/lerobot_policy_dp3/*" in manifest.figure("modes_pattern_2.json").measures


@needs_robots
def test_modes_resume_and_refuse_other_settings(modes: Path, complaint: Callable[[], str]) -> None:
    check_resumes(modes, ONE_PATTERN)
    for option, said in (
        ("--episodes=2", "settings (seeds: [2000, 2000], here [2000, 2001])"),
        ("--demonstrations=2", "other settings (demonstrations: 1, here 2)"),
    ):
        options = [each for each in ONE_PATTERN if each.partition("=")[0] != option.partition("=")[0]]
        assert command.main([*options, *places(modes), option]) == 1
        assert said in complaint()


def test_patterns_have_datasets_of_their_own(tmp_path: Path) -> None:
    stages = ModeStages(tmp_path, 25, 1.0, Trials(2000, 20, 400), Training())
    cells = [Pattern(variant=name) for name in PATTERNS]
    assert len({cell.dataset for cell in cells}) == len({stages.trained(cell) for cell in cells}) == 3
    assert len({stages.source(cell) for cell in cells}) == 1
    assert PATTERNS.keys() == paper.MODES.keys()
    made = modes_report.Found(None, {})
    assert made.is_empty and made.angles_deg() == {}


# -- bad options -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("args", "message", "code"),
    [
        (["anchors", "--anchors=11"], "unknown anchor '11'.", 1),
        (["anchors", "--grid=0"], "--grid=0 should be at least 1.", 2),
        (["anchors", "--demonstration=-1"], "--demonstration=-1 should be at least 0.", 2),
        (["anchors", "--redraw", "--jobs=2"], "--redraw runs nothing; leave out --jobs and --stage.", 2),
        (["anchors", "--redraw"], "nothing is finished in ", 1),
        (["modes", "--patterns=pattern_3"], "unknown pattern 'pattern_3'. Did you mean 'pattern_", 1),
        (["modes", "--stage=replays"], "unknown --stage 'replays'. Did you mean 'replay'?", 2),
        (["modes", "--redraw", "--stage=replay"], "--redraw runs nothing; leave out --jobs and --stage.", 2),
        (["modes", "--redraw"], "nothing is finished in ", 1),
    ],
)
def test_bad_options_are_one_clear_line(
    args: list[str], message: str, code: int, tmp_path: Path, complaint: Callable[[], str]
) -> None:
    assert command.main([*args, *places(tmp_path)]) == code
    assert message in complaint()


@pytest.mark.parametrize("name", ["anchors", "modes"])
def test_a_robot_without_its_description_is_said_before_any_work(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, complaint: Callable[[], str]
) -> None:
    monkeypatch.delenv("CEI_GYM_PACKAGE_PATH", raising=False)
    load_embodiment.cache_clear()
    assert command.main([name, *places(tmp_path)]) == 1
    assert "CEI_GYM_PACKAGE_PATH" in complaint()
    assert not [*tmp_path.iterdir()]
    load_embodiment.cache_clear()


# -- what they ask of environments and conversions ---------------------------------------------------------------------


def test_buttons_are_drawn_around_a_middle_also_in_a_copy() -> None:
    plain, there = gym.make(BUTTON, clouds=False), gym.make(BUTTON, clouds=False, middle_m=[-0.2, 0.4])
    copy = pickle.loads(pickle.dumps(there.unwrapped))
    for seed in (0, 1):
        state, moved, copied = (env.reset(seed=seed)[0]["environment_state"] for env in (plain, there, copy))
        np.testing.assert_allclose(moved - state, [-0.2, 0.4, 0, 0], atol=1e-6)
        np.testing.assert_array_equal(moved, copied)
    for env in (plain, there, copy):
        env.close()


@pytest.mark.parametrize("middle_m", [[0.3, 0.0], [0.0, -0.5], [0.0], "0,0", [float("nan"), 0.0], None])
def test_a_middle_that_is_none_on_the_table_is_one_clear_line(middle_m: object) -> None:
    with pytest.raises(CEIError, match=r"middle_m=.* x and y in metres, at most 0\.26 and 0\.46 from the table's"):
        gym.make(BUTTON, middle_m=middle_m)


def test_an_environment_takes_its_own_arguments_and_those_of_all() -> None:
    check_arguments(BUTTON, {"middle_m": [0, 0], "cameras": ["front"], "start_qpos": None, "max_episode_steps": 3})
    for name in ("others", "embodiment", "midle_m"):
        with pytest.raises(CEIError, match=f"unknown argument of {BUTTON} '{name}'"):
            check_arguments(BUTTON, {name: 1})
    with pytest.raises(CEIError, match="unknown argument of CEI-PickCube-Panda-PandaGripper 'middle_m'"):
        check_arguments("CEI-PickCube-Panda-PandaGripper", {"middle_m": [0, 0]})


def test_arguments_of_the_command_line_reach_the_environment() -> None:
    task = BUTTON.removeprefix("CEI-")
    args = [f"--task={task}", "--render=false", "--augment=false", '--arguments={"middle_m": [-0.1, 0.3]}']
    config = draccus.parse(CEIEnvConfig, args=args)
    assert config.gym_kwargs["middle_m"] == [-0.1, 0.3]
    vector = config.create_envs(1)["cei"][0]
    shown, _ = vector.reset(seed=7)
    assert (np.abs(shown["environment_state"][0, :2] - [-0.1, 0.3]) < 0.081).all()
    vector.close()
    for arguments, said in (
        ({"midle_m": [0, 0]}, f"unknown argument of {BUTTON} 'midle_m'. Did you mean 'middle_m'?"),
        ({"cameras": ["front"]}, "--env.arguments has cameras, which --env.cameras is for."),
        ({"max_episode_steps": 3}, "--env.arguments has max_episode_steps, which --env.episode_length is for."),
    ):
        with pytest.raises(CEIError, match=said.replace("?", r"\?")):
            CEIEnvConfig(task=task, arguments=arguments)


def test_a_conversion_may_take_one_of_its_modes_alone() -> None:
    config = parse(ConvertConfig, [*CONVERT, "--init=eis", "--init.modes=2", "--init.mode=1"], "cei-convert", "")
    assert (config.init.method, config.init.modes, config.init.mode) == ("eis", 2, 1)
    for options, said in (
        (["--init.modes=2", "--init.mode=2"], "init.mode=2 is one of init.modes=2, counted from 0"),
        (["--init.mode=0"], "init.mode=0 is one of init.modes=1, counted from 0, which should be at least 2."),
        (["--init.modes=2", "--init.mode=-1"], "init.mode=-1 must be at least 0."),
    ):
        with pytest.raises(CEIError, match=said):
            parse(ConvertConfig, [*CONVERT, *options], "cei-convert", "")
