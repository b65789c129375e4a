"""The quality of episodes, the gate, and the picture of both."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import killed
import numpy as np
import pytest
from conversions import records
from PIL import Image

from cei_converters import convert
from cei_converters.conversion.gate import Gate
from cei_converters.sources.reader import DatasetReader
from cei_gym.alignment import AlignmentProblem, AlignmentReport, Track
from cei_gym.alignment.judge.clearance import Clearance, Penetration
from cei_gym.alignment.judge.quality import assess
from cei_gym.alignment.judge.report import make_report
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree

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


# -- the score -----------------------------------------------------------------------------------------------------------


def test_a_perfect_episode_has_quality_1() -> None:
    quality = assess(PERFECT)
    assert quality.parts == {"residual": 1, "limits": 1, "jumps": 1, "clearance": 1, "reach": 1}
    assert quality.score == 1
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
    quality = assess(replace(PERFECT, **worse))
    assert quality.weakest == part
    assert quality.score == quality.parts[part] == pytest.approx(score)
    assert quality.frame == 7


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


# -- the gate ------------------------------------------------------------------------------------------------------------


def test_gate() -> None:
    both = Gate(0.3, 0.6)
    assert [both.decision(score) for score in (0.29, 0.3, 0.59, 0.6)] == ["dropped", "flagged", "flagged", "kept"]
    assert [Gate().decision(0.0), Gate(min_quality=0.5).decision(0.4), Gate(flag=0.5).decision(0.4)] == [
        "kept",
        "dropped",
        "flagged",
    ]
    entries = [{"episode": episode, "quality": quality} for episode, quality in ((4, 0.1), (5, 0.5), (7, 0.9))]
    assert both.judge(entries) == {"dropped": [4], "flagged": [5]}
    with pytest.raises(CEIError, match=r"no episode of 3 reaches --min_quality=0\.95 \(the best has 0\.90\)"):
        Gate(0.95).judge(entries)


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--min_quality=1.5"], 2, "--min_quality=1.5: qualities are from 0 to 1."),
        (["--flag=-0.1"], 2, "--flag=-0.1: qualities are from 0 to 1."),
        (["--flag=nan"], 2, "--flag=nan should be a finite number."),
        (["--min_quality=0.5", "--flag=0.5"], 2, "--flag=0.5 marks nothing that --min_quality=0.5 keeps"),
        (["--min_quality=1"], 1, "no episode of 5 reaches --min_quality=1 (the best has 0."),
    ],
)
def test_bad_bounds(
    options: list[str], code: int, message: str, source: Path, tmp_path: Path, complaint: Callable
) -> None:
    assert convert.main(killed.arguments(source, tmp_path / "out", *options)) == code
    assert message in complaint()
    assert list(tmp_path.iterdir()) == []


# -- conversions ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scores(source: Path) -> np.ndarray:
    """Of all episodes, from a conversion without a gate."""
    root = source.with_name("ungated")
    assert convert.main(killed.arguments(source, root)) == 0
    found = [record["quality"] for record in records(root)]
    assert not any("flagged" in record for record in records(root))
    assert [quality["score"] for quality in found] == [min(quality["parts"].values()) for quality in found]
    return np.array([quality["score"] for quality in found])


def test_the_gate_drops_and_flags(source: Path, scores: np.ndarray, tmp_path: Path, capsys: Any) -> None:
    order = np.argsort(scores)
    low, high = (float(scores[order[i : i + 2]].mean()) for i in (0, 2))
    worst, *flagged = order[:3].tolist()
    kept = [index for index in range(len(scores)) if index != worst]
    root, result = tmp_path / "out", tmp_path / "result.json"
    gate = [f"--min_quality={low}", f"--flag={high}"]
    assert convert.main(killed.arguments(source, root, *gate, f"--json={result}")) == 0
    printed = capsys.readouterr().out
    assert (
        f"Quality: dropped 1 (episode {worst}), flagged 2 (episode {', '.join(map(str, sorted(flagged)))})." in printed
    )
    assert [record["source_episode"] for record in records(root)] == kept
    assert [record["source_episode"] for record in records(root) if record.get("flagged")] == sorted(flagged)
    np.testing.assert_array_equal([record["quality"]["score"] for record in records(root)], scores[kept])
    assert len(DatasetReader("me/out", root)) == len(kept)
    found = json.loads(result.read_text())
    assert found["gate"] == {"dropped": [worst], "flagged": sorted(flagged)}
    assert [entry["episode"] for entry in found["results"]] == [each["episode"] for each in found["residuals"]] == kept
    card = (root / "README.md").read_text()
    assert "are left out (1)" in card
    assert (
        f"`flagged` in `meta/cei_episodes.jsonl`: {', '.join(str(kept.index(index)) for index in sorted(flagged))}."
        in card
    )
    assert "(meta/quality.png)" in card
    # the picture is of all of them, whatever the user's own style is
    before = Image.open(source.with_name("ungated") / "meta/quality.png")
    after = Image.open(root / "meta/quality.png")
    assert before.size == after.size
    assert before.tobytes() != after.tobytes()


def test_a_converted_dataset_that_is_converted_again_is_judged_anew(
    source: Path, scores: np.ndarray, tmp_path: Path
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert convert.main(killed.arguments(source, first, "--flag=1", "--episodes=0")) == 0
    assert records(first)[0]["flagged"]
    again = [arg.replace("me/pick", "me/first") for arg in killed.arguments(first, second)]
    assert convert.main(["--target=Panda-PandaGripper" if "--target=" in arg else arg for arg in again]) == 0
    assert "flagged" not in records(second)[0]
    assert records(second)[0]["quality"] != records(first)[0]["quality"]
