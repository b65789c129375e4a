"""How well episodes follow, how likely they work, the gate, and the picture of all."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import killed
import numpy as np
import pytest
from conversions import records
from scipy.stats import beta

from cei_converters import convert
from cei_converters.conversion.gate import Gate
from cei_converters.conversion.quality import PRIOR, Quality
from cei_converters.conversion.verdict import Verdict
from cei_converters.dataset.records import fidelity_of, quality_of
from cei_gym.alignment import AlignmentProblem, AlignmentReport, Track
from cei_gym.alignment.judge.clearance import Clearance, Penetration
from cei_gym.alignment.judge.fidelity import assess
from cei_gym.alignment.judge.report import make_report
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree
from cei_gym.twin import Evidence
from cei_gym.twin.calibration import WORKED

PERFECT = AlignmentReport(
    pad_distance_mm=np.zeros(10),
    normal_angle_deg=np.zeros(10),
    objective_m=np.zeros(10),
    iterations=np.zeros(10, int),
    limit_hits=np.zeros(10, int),
    joint_step_rad=np.zeros(10),
    arm_at_limit=np.zeros(10, bool),
    speed_share=np.zeros(10),
    penetration_mm=np.zeros(10),
    unreachable_mm=30.0,
)


def at(frame: int, value: float) -> np.ndarray:
    return np.where(np.arange(10) == frame, value, 0.0)


# -- fidelity -----------------------------------------------------------------------------------------------------------


def test_a_perfect_episode_has_fidelity_1() -> None:
    fidelity = assess(PERFECT)
    assert fidelity.parts == {"residual": 1, "limits": 1, "jumps": 1, "clearance": 1, "reach": 1}
    assert fidelity.score == 1
    assert assess(replace(PERFECT, speed_share=np.ones(10))).score == 1  # as fast as it may be


@pytest.mark.parametrize(
    ("worse", "part", "score"),
    [
        ({"pad_distance_mm": np.full(10, 10.0) + at(7, 1e-9)}, "residual", 1 / 1.25),  # half of the 20 mm
        ({"arm_at_limit": np.arange(10) > 6}, "limits", 1 / (1 + 0.6**2)),  # 3 frames of 10, half of them is 0.5
        ({"speed_share": at(7, 3.0)}, "jumps", 1 / 5),  # 2 limits beyond it
        ({"penetration_mm": at(7, 10.0)}, "clearance", 1 / 2),
        (
            {"pad_distance_mm": at(7, 31.0), "unreachable_mm": 30.0},
            "reach",
            1 / 5,
        ),  # 1 frame of 10, at 1 of 20 it is 0.5
    ],
)
def test_the_score_is_that_of_the_worst_part(worse: dict[str, Any], part: str, score: float) -> None:
    fidelity = assess(replace(PERFECT, **worse))
    assert fidelity.weakest == part
    assert fidelity.score == fidelity.parts[part] == pytest.approx(score)
    assert fidelity.frame == 7


def test_worse_is_never_better() -> None:
    random = np.random.default_rng(0)
    for name in ("pad_distance_mm", "speed_share", "penetration_mm"):
        values = random.uniform(0, 60, 10)
        scores = [assess(replace(PERFECT, **{name: values * scale})).score for scale in np.linspace(0, 2, 30)]
        assert (np.diff(scores) <= 0).all()
        assert min(scores) >= 0


def test_what_the_score_is_made_of_is_measured() -> None:
    """With a robot whose limits, speeds and size are known from elsewhere."""
    embodiment = load_embodiment("Panda-PandaGripper")
    problem = AlignmentProblem(sample_representation(embodiment, 16, 0), KinematicTree(embodiment))
    u = np.tile(embodiment.coupled.reduce(embodiment.home), (3, 1))
    u[1, 0] += 0.1
    u[2, 0] = 2.8973  # the data sheet's limit of joint 1
    track = Track(u, np.zeros(3), np.zeros(3, int))
    points, normals = problem.place(u)
    deep_m = np.array([0, 0.02, 0.01])
    between = ((), ("link4", "link6"), ("hand", "the support surface"))
    report = make_report(problem, points, normals, track, 0.05, 30.0, 0.05, Penetration(deep_m, between))
    np.testing.assert_array_equal(report.arm_at_limit, [False, False, True])
    fastest = 2.175  # rad/s, the data sheet's
    np.testing.assert_allclose(report.speed_share, np.abs(np.diff(u[:, 0], prepend=u[0, 0])) / (fastest * 0.05))
    np.testing.assert_allclose(report.penetration_mm, [0, 20, 10])
    assert report.penetrates == "link4 in link6, frame 1"
    unknown = make_report(problem, points, normals, track, 0.05, 30.0)
    assert not unknown.speed_share.any()
    assert not unknown.penetration_mm.any()
    assert unknown.penetrates is None


def test_depth_grows_with_the_surface() -> None:
    embodiment = load_embodiment("Panda-PandaGripper")
    clearance, qpos = Clearance(embodiment), np.array([embodiment.home] * 2)
    qpos[1, 1] += 0.5  # bows
    free = clearance.penetration(qpos, -1.0).depth_m
    np.testing.assert_allclose(free, 0)
    heights = (0.3, 0.4, 0.5)
    depths = np.array([clearance.penetration(qpos, height).depth_m for height in heights])
    np.testing.assert_allclose(np.diff(depths[:, 1]), 0.1, atol=1e-9)
    assert (depths[:, 1] > depths[:, 0]).all()
    assert clearance.worst(qpos, 0.4)[0] == depths[1].max()


# -- quality -------------------------------------------------------------------------------------------------------------


def verdict(success: bool, held: float | None = None, judged: int = 1) -> Verdict:
    return Verdict(0, success, 1, "plain", "" if success else "slipped", held=held, judged=judged)


def test_replays_say_how_likely_an_episode_works() -> None:
    """By the mean of the beta distribution that is left of `PRIOR`; more replays make surer."""
    works, fails = PRIOR
    for said, held, n in (
        (verdict(True), 1, 1),
        (verdict(False), 0, 1),
        (verdict(True, held=0.8, judged=5), 4, 5),
        (verdict(True, held=1.0, judged=5), 5, 5),
    ):
        quality = Quality.of(said, None)
        assert quality.by == "replays"
        assert quality.probability == pytest.approx(beta(works + held, fails + n - held).mean())
    assert Quality.of(verdict(True), Evidence.of([False] * 4, ["box"], 1.0)).by == "replays"  # which know better


def test_a_twin_says_it_by_how_often_its_answers_were_right() -> None:
    for answer, votes in (("holds", [True] * 4), ("fails", [False] * 4), ("unsure", [True, False])):
        evidence = Evidence.of(votes, ["box"], 1.0)
        works, of = WORKED[answer]
        assert evidence.answer == answer
        assert Quality.of(None, evidence).record() == {
            "probability": pytest.approx((works + 1) / (of + 2)),
            "by": "twin",
        }


def test_what_nothing_tells_is_not_known() -> None:
    assert Quality.of(None, None).record() == {}
    assert Quality.of(None, Evidence.none("there are no clouds")).probability is None


# -- the gate ------------------------------------------------------------------------------------------------------------


def test_gate() -> None:
    both = Gate(0.3, 0.6)
    qualities = (None, 0.29, 0.3, 0.59, 0.6)
    assert [both.decision(each) for each in qualities] == ["dropped", "dropped", "flagged", "flagged", "kept"]
    assert [Gate().decision(None), Gate(min_quality=0.0).decision(None), Gate(flag=0.5).decision(None)] == [
        "kept",
        "dropped",
        "flagged",
    ]
    entries = [{"episode": episode, "quality": quality} for episode, quality in ((4, None), (5, 0.5), (7, 0.9))]
    assert both.judge(entries) == {"dropped": [4], "flagged": [5]}
    with pytest.raises(CEIError, match=r"no episode of 3 reaches --min_quality=0\.95 \(the best has 0\.90\)"):
        Gate(0.95).judge(entries)
    with pytest.raises(CEIError, match=r"no episode of 1 reaches --min_quality=0\.1 \(nothing is known of any\)"):
        Gate(0.1).judge(entries[:1])


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--min_quality=1.5"], 2, "--min_quality=1.5: qualities are from 0 to 1."),
        (["--flag=-0.1"], 2, "--flag=-0.1: qualities are from 0 to 1."),
        (["--flag=nan"], 2, "--flag=nan should be a finite number."),
        (["--min_quality=0.5", "--flag=0.5"], 2, "--flag=0.5 marks nothing that --min_quality=0.5 keeps"),
        (["--min_quality=0.5"], 2, "--min_quality is about the probability that an episode works, which nothing tells"),
        (["--flag=0.5"], 2, "add --verify or --refine where the task has an environment, else --evidence"),
        (["--evidence", "--min_quality=0.1"], 1, "no episode of 5 reaches --min_quality=0.1 (nothing is known of any)"),
    ],
)
def test_bad_bounds(
    options: list[str], code: int, message: str, source: Path, tmp_path: Path, complaint: Callable
) -> None:
    assert convert.main(killed.arguments(source, tmp_path / "out", *options)) == code
    assert message in complaint()
    assert list(tmp_path.iterdir()) == []


# -- conversions ---------------------------------------------------------------------------------------------------------


def test_without_a_gate_all_are_kept(source: Path, tmp_path: Path, capsys: Any) -> None:
    root = tmp_path / "out"
    assert convert.main(killed.arguments(source, root)) == 0
    found = records(root)
    assert not any({"flagged", "quality"} & set(record) for record in found)
    for record in found:
        assert record["fidelity"]["score"] == min(record["fidelity"]["parts"].values())
    card = (root / "README.md").read_text()
    assert "Whether episodes work in contact is not known" in card and "(meta/quality.png)" in card
    assert "quality" not in capsys.readouterr().out.split("Wrote")[0].replace("quality.png", "")


def test_what_is_not_known_is_marked(source: Path, tmp_path: Path, capsys: Any) -> None:
    """Arms that wave carry nothing, so no twin can judge them."""
    root, result = tmp_path / "out", tmp_path / "result.json"
    assert convert.main(killed.arguments(source, root, "--evidence", "--flag=0.5", f"--json={result}")) == 0
    assert "Quality: dropped 0, flagged 5 (episode 0, 1, 2, 3, 4)." in capsys.readouterr().out
    assert all(record["flagged"] and "quality" not in record for record in records(root))
    assert json.loads(result.read_text())["gate"] == {"dropped": [], "flagged": [0, 1, 2, 3, 4]}
    card = (root / "README.md").read_text()
    assert "Those not known to work with 0.5 are `flagged` in `meta/cei_episodes.jsonl`: 0, 1, 2, 3, 4." in card


def test_a_converted_dataset_that_is_converted_again_is_judged_anew(source: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert convert.main(killed.arguments(source, first, "--evidence", "--flag=1", "--episodes=0")) == 0
    assert records(first)[0]["flagged"]
    again = [arg.replace("me/pick", "me/first") for arg in killed.arguments(first, second)]
    assert convert.main(["--target=Panda-PandaGripper" if "--target=" in arg else arg for arg in again]) == 0
    assert "flagged" not in records(second)[0]
    assert records(second)[0]["fidelity"] != records(first)[0]["fidelity"]


def test_records_of_before_are_read() -> None:
    old = {"quality": {"score": 0.7, "parts": {"reach": 0.7}}}
    assert fidelity_of(old) == old["quality"] and quality_of(old) == {}
    new = {"quality": {"probability": 0.9, "by": "twin"}, "fidelity": {"score": 0.7, "parts": {"reach": 0.7}}}
    assert fidelity_of(new) == new["fidelity"] and quality_of(new) == new["quality"]
    assert fidelity_of({}) == quality_of({}) == {}
