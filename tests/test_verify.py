"""Verified transfer: what is tried, in which order, what is kept of it, and what the commands say."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import older
import pytest
from conversions import record_cubes, records

from cei_converters import convert, replay
from cei_converters.conversion.refine import RefineOptions
from cei_converters.conversion.sample import Sample
from cei_converters.conversion.starting import choose_start
from cei_converters.conversion.verdict import Verdict, sentence, summarise
from cei_converters.conversion.verify import Verifier, VerifyOptions
from cei_converters.dataset.corrections import Corrected
from cei_converters.simulation.perturbation import Perturbation
from cei_converters.simulation.stage import Stage
from cei_converters.sources.reader import DatasetReader
from cei_gym.alignment import InitialisationOptions
from cei_gym.alignment.contact.correction import Correction
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import CloudOptions
from cei_gym.transfer import Attempt, Transfer

SOURCE, TARGET = "Panda-PandaGripper", "IIWA-Inspire"
ENV = f"CEI-PickCube-{TARGET}"
# Physics does not depend on clouds, and what is tried here not on how many starts there were.
CLOUDS = CloudOptions(robot_points=256, points=16)
INIT = InitialisationOptions(starts=32, basins=4)
FAST = ["--clouds.robot_points=256", "--clouds.points=16", "--init.starts=32", "--init.basins=4"]


class FakeStage(Stage):
    """Has every demonstration fail that `succeeds` does not accept, and keeps what it was shown."""

    def __init__(self, succeeds: Callable[["FakeStage"], bool]) -> None:
        self.succeeds = succeeds
        self.played: list[Demonstration] = []

    def play(
        self, demonstration: Demonstration, filmed: bool = False, perturbation: Any = None
    ) -> tuple[dict[str, Any], list]:
        self.played.append(demonstration)
        success = self.succeeds(self)
        return {"success": success, "failure": "" if success else "slipped"}, []

    def close(self) -> None:
        pass


def after(failures: int) -> Callable[[FakeStage], bool]:
    """Success once so many replays have failed."""
    return lambda stage: len(stage.played) > failures


def never(_: FakeStage) -> bool:
    return False


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds `source`, a recorded dataset of two episodes."""
    folder = tmp_path_factory.mktemp("verify")
    record_cubes(folder / "source", 2, 3)
    return folder


@pytest.fixture(scope="module")
def demonstration(folder: Path) -> Demonstration:
    return DatasetReader("me/source", folder / "source").read(0)


@pytest.fixture(scope="module")
def transfer(demonstration: Demonstration) -> Transfer:
    fitted = Transfer(load_embodiment(SOURCE), load_embodiment(TARGET), clouds=CLOUDS, init=INIT)
    fitted.fit([demonstration])
    return fitted


def converted(folder: Path, root: Path, *options: str) -> int:
    source = ["--dataset.repo_id=me/source", f"--dataset.root={folder / 'source'}"]
    target = [f"--target={TARGET}", "--new_repo_id=me/target", f"--new_root={root}"]
    return convert.main([*source, *target, *FAST, f"--json={root}.json", *options])


def result(root: Path) -> dict[str, Any]:
    return json.loads(root.with_suffix(".json").read_text())


# -- what there is to try ------------------------------------------------------------------------------------------------


def test_attempts_come_in_their_order_and_each_kind_has_its_turn(transfer: Transfer) -> None:
    named = [str(attempt) for attempt in transfer.attempts(100)]
    basins = [name for name in named if name.startswith("basin")]
    assert named == ["plain", *basins, "squeeze x0.5", "squeeze x1.5", "pads reduced"]
    assert "basin 1" not in basins  # the plain one's
    assert basins == sorted(basins)
    few = [str(attempt) for attempt in transfer.attempts(5)]
    assert few == ["plain", *basins[:1], "squeeze x0.5", "squeeze x1.5", "pads reduced"]
    assert [str(attempt) for attempt in transfer.attempts(1)] == ["plain"]
    assert len(transfer.attempts(3)) == 3


def test_attempts_move_differently_and_without_clouds(transfer: Transfer, demonstration: Demonstration) -> None:
    plain, _ = transfer(demonstration)
    assert plain.point_cloud_world is not None
    same, _ = transfer(demonstration, attempt=Attempt(), clouds=False)
    assert same.point_cloud_world is None
    np.testing.assert_array_equal(same.action, plain.action)
    for attempt in (Attempt(basin=1), Attempt(representation="reduced")):
        moved, report = transfer(demonstration, attempt=attempt, clouds=False)
        assert moved.qpos.shape != plain.qpos.shape or np.abs(moved.qpos - plain.qpos).max() > 1e-2
        assert not report.unreachable_frames
    less, _ = transfer(demonstration, attempt=Attempt(squeeze=0.5), clouds=False)
    more, _ = transfer(demonstration, attempt=Attempt(squeeze=1.5), clouds=False)
    np.testing.assert_array_equal(less.qpos, plain.qpos)
    closing = [np.abs(moved.action[:-1] - moved.qpos[1:]).max() for moved in (less, plain, more)]
    assert closing[0] < closing[1] < closing[2]


# -- the verifier --------------------------------------------------------------------------------------------------------


def test_a_plain_transfer_that_succeeds_is_kept_as_it_is(transfer: Transfer, demonstration: Demonstration) -> None:
    stage = FakeStage(after(0))
    moved, _, verdict = Verifier(transfer, stage, VerifyOptions(enabled=True))(demonstration)
    assert verdict.record() == {"success": True, "attempts": 1, "how": "plain", "failure": ""}
    np.testing.assert_array_equal(moved.action, transfer(demonstration)[0].action)
    assert len(stage.played) == 1
    # What is replayed is what a dataset holds.
    np.testing.assert_array_equal(stage.played[0].qpos, moved.qpos.astype(np.float32))


def test_others_are_tried_until_one_succeeds(transfer: Transfer, demonstration: Demonstration) -> None:
    stage = FakeStage(after(2))
    moved, report, verdict = Verifier(transfer, stage, VerifyOptions(enabled=True))(demonstration)
    assert verdict.success
    assert (verdict.attempts, verdict.failure) == (3, "slipped")
    assert verdict.how.startswith("basin")
    np.testing.assert_array_equal(stage.played[-1].action, moved.action)
    assert moved.point_cloud_world is not None
    assert moved.point_cloud_world.shape == (len(moved), 16, 3)
    assert len(report.pad_distance_mm) == len(moved)
    assert verdict.row() == {"plain": "slipped", "verified": verdict.how}
    again, _, same = Verifier(transfer, FakeStage(after(2)), VerifyOptions(enabled=True))(demonstration)
    assert same == verdict
    for field in ("qpos", "action", "point_cloud_world"):
        np.testing.assert_array_equal(getattr(again, field), getattr(moved, field))


def test_nothing_is_played_twice_nor_more_than_was_asked_for(transfer: Transfer, demonstration: Demonstration) -> None:
    stage = FakeStage(never)
    moved, _, verdict = Verifier(transfer, stage, VerifyOptions(enabled=True, attempts=6))(demonstration)
    assert verdict.record() == {"success": False, "attempts": len(stage.played), "how": "plain", "failure": "slipped"}
    assert not verdict.dropped
    assert 4 <= len(stage.played) <= 6
    np.testing.assert_array_equal(moved.action, stage.played[0].action)
    for i, one in enumerate(stage.played):
        for other in stage.played[:i]:
            assert one.action.shape != other.action.shape or np.abs(one.action - other.action).max() > 1e-3


def test_what_cannot_be_reached_fails_without_a_replay(demonstration: Demonstration) -> None:
    """Unless it is allowed."""

    class OutOfReach:
        unreachable_frames = (3,)

    class Plain:
        def aligned(self, demonstration: Demonstration, *_: object) -> Demonstration:
            return demonstration

        def made(self, aligned: Demonstration, *_: object, **__: object):
            return aligned, OutOfReach()

        def attempts(self, most: int, mode: int) -> list[Attempt]:
            return [Attempt()]

    plain: Any = Plain()
    for allowed in (False, True):
        stage = FakeStage(after(0))
        verifier = Verifier(plain, stage, VerifyOptions(enabled=True, drop=True), allow_unreachable=allowed)
        _, _, verdict = verifier(demonstration)
        assert (verdict.success, verdict.dropped, len(stage.played)) == (allowed, not allowed, int(allowed))
        assert verdict.failure == ("" if allowed else "unreachable")


# -- the command ---------------------------------------------------------------------------------------------------------


type Use = Callable[[Callable[[FakeStage], bool]], None]


@pytest.fixture
def use(transfer: Transfer, monkeypatch: pytest.MonkeyPatch) -> Use:
    """Puts a fake stage into `cei-convert`, which then starts where `transfer` does: choosing takes longest."""

    def fit(self: Transfer, _: object) -> None:
        self.start_from(transfer.finalists)

    def put(succeeds: Callable[[FakeStage], bool]) -> None:
        monkeypatch.setattr("cei_converters.conversion.converter.open_stage", lambda *_: FakeStage(succeeds))
        monkeypatch.setattr(Transfer, "fit", fit)

    return put


def fails_at_first(stage: FakeStage) -> bool:
    """The first replay fails, all others succeed."""
    return len(stage.played) != 1


def fails_in_the_first_episode(stage: FakeStage) -> bool:
    return stage.played[-1].index != 0


def test_the_dataset_says_what_became_of_each_episode(
    folder: Path, tmp_path: Path, use: Use, capsys: pytest.CaptureFixture
) -> None:
    use(fails_at_first)
    root = tmp_path / "target"
    assert converted(folder, root, "--verify") == 0
    printed = capsys.readouterr().out
    assert "plain 1/2, verified 2/2 (1 retried), dropped 0" in printed
    first, second = (episode["verified"] for episode in records(root))
    assert first["success"]
    assert first["attempts"] == 2
    assert first["how"] in printed
    assert first["failure"] == "slipped"
    assert second == {"success": True, "attempts": 1, "how": "plain", "failure": ""}
    found = result(root)["verify"]
    assert (found["plain_successes"], found["verified_successes"], found["episodes"], found["dropped"]) == (1, 2, 2, [])
    assert found["how"] == {first["how"]: 1, "plain": 1}
    card = (root / "README.md").read_text()
    assert "plain transfer succeeds in 1 of 2" in card
    assert "2 of 2 succeed" in card


def test_what_never_succeeds_is_kept_plain_or_dropped(
    folder: Path, tmp_path: Path, use: Use, capsys: pytest.CaptureFixture
) -> None:
    use(fails_in_the_first_episode)
    kept, dropped = tmp_path / "kept", tmp_path / "dropped"
    assert converted(folder, kept, "--verify", "--verify.attempts=1", "--episodes=0") == 0
    verdict = {"success": False, "attempts": 1, "how": "plain", "failure": "slipped"}
    assert [episode["verified"] for episode in records(kept)] == [verdict]
    assert converted(folder, dropped, "--verify", "--verify.attempts=2", "--verify.drop") == 0
    assert "plain 1/2, verified 1/2 (1 retried), dropped 1" in capsys.readouterr().out
    assert [episode["source_episode"] for episode in records(dropped)] == [1]
    assert len(DatasetReader("me/target", dropped)) == 1
    found = result(dropped)
    assert found["episodes"] == len(found["results"]) == len(found["residuals"]) == 1
    assert found["verify"]["dropped"] == [0]
    assert found["verify"]["results"][0]["failure"] == "slipped"
    assert "Left out are 1" in (dropped / "README.md").read_text()


def test_an_episode_that_goes_another_way_is_told_of_and_left_out_where_that_is_asked_for(
    folder: Path, tmp_path: Path, use: Use, capsys: pytest.CaptureFixture, complaint: Callable
) -> None:
    use(fails_at_first)  # and then goes on from another basin
    kept, dropped = tmp_path / "kept", tmp_path / "dropped"
    assert converted(folder, kept, "--verify") == 0
    printed = capsys.readouterr().out
    assert records(kept)[0]["verified"]["how"].startswith("basin")
    assert "note: in episode 0 the target goes another way in its joints than in the others; --drop_strays" in printed
    assert [episode["alignment"].get("another_way") for episode in records(kept)] == [True, None]
    assert converted(folder, dropped, "--verify", "--drop_strays") == 0
    assert "goes another way in its joints than in the others; left out" in capsys.readouterr().out
    assert [episode["source_episode"] for episode in records(dropped)] == [1]
    assert result(dropped)["strays"] == {"episodes": [0], "left_out": True}
    known = json.loads((dropped / "meta/cei.json").read_text())["provenance"]["options"]
    assert known["strays"] == {"episodes": [0], "left_out": True}
    alone = tmp_path / "alone"
    assert converted(folder, alone, "--verify", "--drop_strays", "--episodes=0") == 1
    assert (
        "no episode is left: episode 0 would be left out for going another way than the others; leave out --drop_strays."
        in complaint()
    )
    assert not alone.exists()


def test_nothing_is_left_behind_where_all_are_dropped(
    folder: Path, tmp_path: Path, use: Use, complaint: Callable
) -> None:
    use(never)
    assert (
        converted(folder, tmp_path / "target", "--verify", "--verify.attempts=1", "--verify.drop", "--episodes=1") == 1
    )
    assert "no episode of 1 succeeds" in complaint()
    assert list(tmp_path.iterdir()) == []


def test_it_is_off_by_default_and_says_nothing_then(
    folder: Path, tmp_path: Path, use: Use, capsys: pytest.CaptureFixture
) -> None:
    use(lambda _: pytest.fail("nothing is to be replayed"))
    root = tmp_path / "target"
    assert converted(folder, root, "--episodes=0") == 0
    assert "verif" not in capsys.readouterr().out.lower()
    assert "verify" not in result(root)
    assert "verified" not in records(root)[0]
    assert "verify" not in json.loads((root / "meta" / "cei.json").read_text())["provenance"]["options"]
    assert "Verified" not in (root / "README.md").read_text()


def test_verification_in_physics_agrees_with_a_replay_of_the_dataset(folder: Path, tmp_path: Path) -> None:
    root = tmp_path / "target"
    assert converted(folder, root, "--verify", "--episodes=1") == 0
    verdict = records(root)[0]["verified"]
    assert result(root)["verify"]["plain_successes"] == int(verdict["how"] == "plain" and verdict["success"])
    options = ["--dataset.repo_id=me/target", f"--dataset.root={root}", "--video_episodes=0"]
    assert replay.main([*options, f"--json={tmp_path / 'replay.json'}"]) == 0
    replayed = json.loads((tmp_path / "replay.json").read_text())
    assert replayed["env"] == ENV
    assert replayed["results"][0]["success"] == verdict["success"]


# -- what is refused -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--verify.drop"], 2, "of no use without --verify"),
        (["--verify.attempts=3"], 2, "of no use without --verify"),
        (["--verify=false", "--verify.drop"], 2, "of no use without --verify"),
        (["--verify", "--verify.attempts=0"], 2, "verify.attempts=0 must be at least 1"),
        (["--verify", "--target_pose=0,0,0.912"], 1, "robosuite stands"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    options: list[str], code: int, message: str, folder: Path, tmp_path: Path, complaint: Callable
) -> None:
    assert converted(folder, tmp_path / "target", *options) == code
    assert message in complaint()
    assert list(tmp_path.iterdir()) == []


def test_a_dataset_without_an_environment_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    shutil.copytree(folder / "source", tmp_path / "source")
    path = tmp_path / "source" / "meta" / "cei.json"
    metadata = json.loads(path.read_text())
    metadata["environment"]["id"] = None
    path.write_text(json.dumps(metadata))
    older.forget(tmp_path / "source")
    assert converted(tmp_path, tmp_path / "target", "--verify") == 1
    assert f"me/source names no environment that a {TARGET} could be verified in" in capsys.readouterr().err
    assert not (tmp_path / "target").exists()


def test_options_are_checked_where_they_are_made() -> None:
    with pytest.raises(CEIError, match="at least 1"):
        VerifyOptions(enabled=True, attempts=0)
    assert not VerifyOptions().enabled
    assert sentence(summarise([])) == "plain 0/0, verified 0/0 (0 retried), dropped 0"


# -- refinement ----------------------------------------------------------------------------------------------------------


class Shaken(FakeStage):
    """Has what it is shown succeed as `succeeds` says, which is told how it is perturbed."""

    n_arm = 7

    def __init__(self, succeeds: Callable[[Demonstration, Perturbation | None], bool]) -> None:
        self.played: list[Demonstration] = []
        self.perturbed: list[Any] = []
        self.accepts = succeeds

    def play(
        self, demonstration: Demonstration, filmed: bool = False, perturbation: Any = None
    ) -> tuple[dict[str, Any], list]:
        self.played.append(demonstration)
        self.perturbed.append(perturbation)
        success = self.accepts(demonstration, perturbation)
        return {"success": success, "failure": "" if success else "slipped"}, []


def refined(
    transfer: Transfer, demonstration: Demonstration, stage: Shaken, **options: Any
) -> tuple[Demonstration, Verdict]:
    refine = RefineOptions(enabled=True, **options)
    moved, _, verdict = Verifier(transfer, stage, VerifyOptions(), refine=refine)(demonstration)
    return moved, verdict


def lowest_m(moved: Demonstration) -> float:
    """How low the hand's first link gets."""
    body = load_embodiment(TARGET)
    return float(KinematicTree(body).forward(moved.qpos)[:, body.end_effector_root, 2, 3].min())


def test_what_holds_when_shaken_is_kept_as_it_is(transfer: Transfer, demonstration: Demonstration) -> None:
    stage = Shaken(lambda *_: True)
    moved, verdict = refined(transfer, demonstration, stage, perturbed=3)
    np.testing.assert_array_equal(moved.action, transfer(demonstration)[0].action)
    assert (verdict.how, verdict.held, verdict.plain_held, verdict.replays) == ("plain", 1.0, 1.0, 4)
    assert [each is None for each in stage.perturbed] == [True, False, False, False]


@pytest.mark.parametrize("as_it_is", [False, True])
def test_a_correction_is_searched_that_holds_when_shaken(
    transfer: Transfer, demonstration: Demonstration, as_it_is: bool
) -> None:
    """What fails as it is, and what only holds so; here the hand has to be 3 mm lower."""
    low = lowest_m(transfer(demonstration)[0]) - 0.003

    def accepts(shown: Demonstration, perturbation: Perturbation | None) -> bool:
        return lowest_m(shown) < low or (as_it_is and perturbation is None)

    moved, verdict = refined(transfer, demonstration, Shaken(accepts), perturbed=2)
    assert lowest_m(moved) < low
    assert verdict.success
    assert verdict.how.startswith("corrected (")
    assert (verdict.failure, verdict.held) == ("" if as_it_is else "slipped", 1.0)
    assert verdict.plain_held == pytest.approx(1 / 3 if as_it_is else 0.0)
    assert moved.point_cloud_world is not None
    again, same = refined(transfer, demonstration, Shaken(accepts), perturbed=2)
    assert same == verdict
    np.testing.assert_array_equal(again.action, moved.action)
    _, other = refined(transfer, demonstration, Shaken(accepts), perturbed=2, seed=1)
    assert other.how != verdict.how


def test_the_luckiest_is_not_kept_for_its_luck(transfer: Transfer, demonstration: Demonstration) -> None:
    """All holds in the replays that choose, and nothing in those that confirm."""
    plain = transfer(demonstration)[0].action
    confirming = [Perturbation.draw(demonstration.index, which, Shaken.n_arm) for which in range(2000, 2002)]

    def accepts(shown: Demonstration, perturbation: Perturbation | None) -> bool:
        if shown.action.shape == plain.shape and np.abs(shown.action - plain).max() < 1e-4:
            return perturbation is None
        return perturbation is None or all((perturbation.joints_rad != each.joints_rad).any() for each in confirming)

    moved, verdict = refined(transfer, demonstration, Shaken(accepts), perturbed=2, replays=40)
    assert (verdict.how, verdict.held) == ("plain", pytest.approx(1 / 3))
    assert verdict.attempts > 5
    np.testing.assert_array_equal(moved.action, plain)


def test_it_gives_up_where_nothing_holds(transfer: Transfer, demonstration: Demonstration) -> None:
    stage = Shaken(lambda *_: False)
    moved, verdict = refined(transfer, demonstration, stage, replays=9)
    assert len(stage.played) == 9
    assert verdict.record() == {
        "success": False,
        "attempts": 9,
        "how": "plain",
        "failure": "slipped",
        "held": 0.0,
        "plain_held": 0.0,
        "replays": 9,
    }
    np.testing.assert_array_equal(moved.action, transfer(demonstration)[0].action)


def test_where_nothing_is_held_nothing_is_searched(transfer: Transfer, demonstration: Demonstration) -> None:
    n = transfer.source.n_arm
    hand = np.repeat(demonstration.qpos[:1, n:], len(demonstration), axis=0)
    still = replace(
        demonstration,
        qpos=np.concatenate([demonstration.qpos[:, :n], hand], axis=1),
        action=np.concatenate([demonstration.action[:, :n], hand], axis=1),
    )
    stage = Shaken(lambda *_: False)
    _, verdict = refined(transfer, still, stage)
    assert (len(stage.played), verdict.how) == (1, "plain")


def test_a_refined_dataset_says_what_was_found(
    folder: Path, tmp_path: Path, transfer: Transfer, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """One episode only holds as it is; a correction, any, holds always."""
    plain = [DatasetReader("me/source", folder / "source").read(i) for i in range(2)]
    actions = [transfer(each)[0].action for each in plain]

    def accepts(shown: Demonstration, perturbation: Perturbation | None) -> bool:
        known = actions[shown.index]
        alike = shown.action.shape == known.shape and np.abs(shown.action - known).max() < 1e-4
        return not (alike and perturbation is not None and shown.index == 1)

    monkeypatch.setattr("cei_converters.conversion.converter.open_stage", lambda *_: Shaken(accepts))
    monkeypatch.setattr(Transfer, "fit", lambda self, _: self.start_from(transfer.finalists))
    root = tmp_path / "target"
    assert (
        converted(folder, root, "--refine", "--refine.perturbed=2", "--refine.starts=1", "--refine.generations=0") == 0
    )
    assert "plain 2/2, verified 2/2 (1 retried), dropped 0; of replays held 67% plain, 100% refined" in (
        capsys.readouterr().out
    )
    first, second = (episode["verified"] for episode in records(root))
    assert (first["how"], first["held"]) == ("plain", 1.0)
    assert second["how"].startswith("corrected (")
    assert second["plain_held"] == pytest.approx(1 / 3)
    assert result(root)["verify"]["how"] == {"plain": 1, "corrected": 1}
    _is_corrected(root, 1, second, plain[1], transfer)
    assert "corrected" not in first
    card = (root / "README.md").read_text()
    assert "67% of the plain transfer and 100% of what is kept hold" in card
    options = json.loads((root / "meta/cei.json").read_text())["provenance"]["options"]
    assert options["refine"]["perturbed"] == 2


def _is_corrected(root: Path, index: int, verdict: dict, recorded: Demonstration, transfer: Transfer) -> None:
    """Whether a record has the correction that made its episode, and the joints without it of a frame in which the object is held."""
    corrected = Corrected.of({"verified": verdict}, 10**6, len(transfer.target.joint_names), "it")
    assert corrected is not None
    assert verdict["how"] == f"corrected ({corrected.correction})"
    stored = DatasetReader("me/target", root).read(index, clouds=False)
    again, _ = transfer(recorded, attempt=Attempt(correction=corrected.correction), clouds=False)
    np.testing.assert_allclose(stored.qpos, again.qpos, atol=1e-6)
    plain, _ = transfer(recorded, clouds=False)
    frames = records(root)[index].get("source_frames", range(len(stored)))
    shown = plain.source_frames if plain.source_frames is not None else np.arange(len(plain))
    qpos = plain.qpos[np.flatnonzero(shown == frames[corrected.frame])]
    assert np.abs(qpos - corrected.plain_qpos).max(axis=1).min() < 1e-6
    assert np.abs(stored.qpos[corrected.frame] - corrected.plain_qpos).max() > 1e-3
    lift = stored.environment_state[:, 2] if stored.environment_state is not None else np.zeros(0)
    assert lift[corrected.frame] > lift[0] + 0.005  # it is in the air


def test_episodes_that_fail_alike_are_corrected_alike(
    folder: Path, tmp_path: Path, transfer: Transfer, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """Each has to be 2 mm lower; one episode's own correction is not searched then."""
    recorded = [DatasetReader("me/source", folder / "source").read(i) for i in range(2)]
    low = [lowest_m(transfer(each)[0]) - 0.002 for each in recorded]
    monkeypatch.setattr(
        "cei_converters.conversion.converter.open_stage",
        lambda *_: Shaken(lambda shown, _: lowest_m(shown) < low[shown.index]),
    )
    monkeypatch.setattr(Transfer, "fit", lambda self, _: self.start_from(transfer.finalists))
    root = tmp_path / "target"
    assert converted(folder, root, "--refine", "--refine.perturbed=2", "--refine.starts=1") == 0
    printed = capsys.readouterr().out
    assert "All episodes are corrected alike where that holds no worse: " in printed
    assert "plain 0/2, verified 2/2 (2 retried)" in printed
    found = {episode["verified"]["how"] for episode in records(root)}
    assert len(found) == 1 and {episode["verified"]["attempts"] for episode in records(root)} == {2}
    common = json.loads((root / "meta/cei.json").read_text())["provenance"]["options"]["refine"]["common"]
    assert found == {f"corrected ({Correction(**common)})"}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--refine.robust=0.5"], "--refine.robust is of no use without --refine."),
        (["--refine", "--refine.robust=1.5"], "refine.robust=1.5 must be over 0, and at most 1."),
        (["--refine", "--refine.perturbed=0"], "--refine.perturbed=0 should be at least 1."),
        (["--refine", "--refine.population=1"], "--refine.population=1 should be at least 2."),
        (["--refine", "--refine.starts=0"], "--refine.starts=0 should be at least 1."),
    ],
)
def test_bad_options_of_refinement(
    folder: Path, tmp_path: Path, complaint: Callable, options: list[str], says: str
) -> None:
    assert converted(folder, tmp_path / "target", *options) == 2
    assert says in complaint()


def test_all_follow_from_the_start_that_holds(
    folder: Path, tmp_path: Path, transfer: Transfer, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """Only what follows from the third start holds."""
    recorded = [DatasetReader("me/source", folder / "source").read(i) for i in range(2)]
    assert len(transfer.finalists) > 2
    wanted = [transfer(each, attempt=Attempt(basin=2), clouds=False)[0].qpos for each in recorded]

    def accepts(shown: Demonstration, _: Perturbation | None) -> bool:
        qpos = wanted[shown.index]
        return shown.qpos.shape == qpos.shape and bool(np.abs(shown.qpos - qpos).max() < 1e-4)

    monkeypatch.setattr("cei_converters.conversion.converter.open_stage", lambda *_: Shaken(accepts))
    monkeypatch.setattr(Transfer, "fit", lambda self, _: self.start_from(transfer.finalists))
    root = tmp_path / "target"
    assert converted(folder, root, "--refine", "--refine.perturbed=2", "--shard_episodes=1") == 0
    said = capsys.readouterr().out
    assert (
        "All episodes follow from start 3, of 3 that were tried, of which 100% of some replays hold, and 0% of" in said
    )
    assert "plain 2/2, verified 2/2 (0 retried)" in said
    for episode, qpos in zip(records(root), wanted, strict=True):
        assert episode["verified"]["how"] == "plain"
        stored = DatasetReader("me/target", root).read(episode["source_episode"], clouds=False)
        np.testing.assert_allclose(stored.qpos, qpos, atol=1e-6)
    metadata = json.loads((root / "meta/cei.json").read_text())["provenance"]["options"]
    assert metadata["refine"]["start"] == {"start": 2, "held": 1.0, "best_held": 0.0, "tried": 3}
    np.testing.assert_allclose(metadata["basins"][0]["u"], transfer.finalists[2].u)
    assert "replays from it hold in 100%, from that in 0%" in (root / "README.md").read_text()

    few = ["--refine.perturbed=2", "--refine.starts=1", "--refine.generations=0", "--refine.replays=4"]
    assert converted(folder, tmp_path / "alone", "--refine", *few) == 0
    assert "All episodes follow from" not in capsys.readouterr().out


def test_another_start_has_to_be_confirmed(transfer: Transfer, folder: Path) -> None:
    """All starts but the first hold in the replays that choose, and none in those that confirm; or all hold, and none is asked."""
    recorded = [DatasetReader("me/source", folder / "source").read(i) for i in range(2)]
    first = [transfer(each, clouds=False)[0].qpos for each in recorded]
    chosen_by = [Perturbation.draw(each.index, 1000, Shaken.n_arm) for each in recorded]

    def lucky(shown: Demonstration, perturbation: Perturbation | None) -> bool:
        qpos = first[shown.index]
        if shown.qpos.shape == qpos.shape and np.abs(shown.qpos - qpos).max() < 1e-4:
            return False
        return perturbation is None or any((perturbation.joints_rad == each.joints_rad).all() for each in chosen_by)

    done: list[int] = []
    refine = RefineOptions(enabled=True, starts=3)
    assert choose_start(Sample(transfer, Shaken(lucky), recorded), refine, done.append) is None
    assert sum(done) == 2  # the second holds in all that choose
    stage = Shaken(lambda *_: True)
    assert choose_start(Sample(transfer, stage, recorded), refine) is None
    assert len(stage.played) == 4
    assert choose_start(Sample(transfer, Shaken(lambda *_: False), recorded), refine) is None


def test_what_a_chosen_start_is_compared_with_is_looked_at_to_the_end(transfer: Transfer, folder: Path) -> None:
    """The start that follows best fails three times from the first, and then holds: that is a fifth, not nothing."""
    recorded = DatasetReader("me/source", folder / "source").read(0)
    shown = [replace(recorded, index=i) for i in range(5)]
    first = transfer(recorded, clouds=False)[0].qpos

    def accepts(moved: Demonstration, _: Perturbation | None) -> bool:
        alike = moved.qpos.shape == first.shape and np.abs(moved.qpos - first).max() < 1e-4
        return not alike or moved.index == 4

    chosen = choose_start(Sample(transfer, Shaken(accepts), shown), RefineOptions(enabled=True))
    assert chosen is not None
    assert (chosen.start, chosen.held, chosen.best_held, chosen.tried) == (1, 1.0, pytest.approx(0.2), 2)
