"""`cei-replay --perturb`: replays that differ a little from what was recorded, and how often what is done holds all the same."""

import json
from pathlib import Path

import numpy as np
import pytest
from conversions import record_cubes
from rollouts import make

from cei_converters import replay
from cei_converters.simulation.perturbation import Perturbation, perturbations
from cei_converters.simulation.stage import Stage
from cei_converters.sources.reader import DatasetReader
from cei_gym.demonstration import Demonstration

ENV, N_ARM = "CEI-PickCube-Panda-PandaGripper", 7


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded dataset of two episodes."""
    root = tmp_path_factory.mktemp("perturb") / "source"
    record_cubes(root, 2, 3)
    return root


@pytest.fixture(scope="module")
def demonstration(root: Path) -> Demonstration:
    return DatasetReader("me/source", root).read(0)


def test_draws_are_small_differ_and_come_again(demonstration: Demonstration) -> None:
    drawn = perturbations(demonstration, 300, N_ARM)
    ways = np.array([[each.offset.x_m, each.offset.y_m] for each in drawn])
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 0.003)
    assert np.abs(ways.mean(axis=0)).max() < 5e-4  # in all directions
    scales = np.array([each.friction_scale for each in drawn])
    assert 0.8 <= scales.min() < 0.81 and 1.19 < scales.max() <= 1.2
    joints = np.array([each.joints_rad for each in drawn])
    assert joints.shape == (300, N_ARM) and joints.std() == pytest.approx(0.002, rel=0.1)
    for one, other in zip(drawn[:5], perturbations(demonstration, 5, N_ARM), strict=True):
        assert one.offset == other.offset and one.friction_scale == other.friction_scale
        np.testing.assert_array_equal(one.joints_rad, other.joints_rad)
    assert Perturbation.draw(1, 0, N_ARM).friction_scale != drawn[0].friction_scale


def test_friction_is_what_is_asked_for_and_only_in_that_episode() -> None:
    env = make("PickCube", "Panda-PandaGripper", clouds=False)
    env.reset(seed=0)
    described = env.model.geom_friction.copy()
    env.reset(seed=0, options={"friction_scale": 0.8})
    np.testing.assert_allclose(env.model.geom_friction, 0.8 * described)
    env.reset(seed=0, options={"friction_scale": 0.5})
    np.testing.assert_allclose(env.model.geom_friction, 0.5 * described)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.model.geom_friction, described)
    env.close()


def test_a_perturbed_replay_starts_where_it_is_said(demonstration: Demonstration) -> None:
    drawn = Perturbation.draw(0, 0, N_ARM)
    with Stage(ENV) as stage:
        taken: list[dict] = []
        reset = stage.env.reset
        stage.env.reset = lambda **given: taken.append(given["options"]) or reset(**given)
        plain, _ = stage.play(demonstration)
        perturbed, _ = stage.play(demonstration, perturbation=drawn)
    assert plain["success"] and perturbed["success"]
    state, qpos = demonstration.environment_state, demonstration.qpos
    assert state is not None
    moved = taken[1]["environment_state"] - state[0]
    np.testing.assert_allclose(moved[:2], [drawn.offset.x_m, drawn.offset.y_m], atol=1e-6)
    np.testing.assert_allclose(moved[2:], 0, atol=1e-6)
    np.testing.assert_allclose(taken[1]["agent_pos"] - qpos[0], [*drawn.joints_rad, 0, 0], atol=1e-6)
    assert taken[1]["friction_scale"] == drawn.friction_scale
    assert "friction_scale" not in taken[0]


def test_what_is_far_off_does_not_hold(demonstration: Demonstration) -> None:
    """A replay that could not fail would say nothing: with joints 20 degrees off nothing is grasped."""
    with Stage(ENV) as stage:
        off = Perturbation(Perturbation.draw(0, 0, N_ARM).offset, 1.0, np.full(N_ARM, 0.35))
        assert not stage.play(demonstration, perturbation=off)[0]["success"]


def test_the_command_reports_the_share_beside_the_plain_result(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--dataset.repo_id=me/source", f"--dataset.root={root}", "--video_episodes=0"]
    assert replay.main([*options, "--perturb=3", f"--json={tmp_path / 'replay.json'}"]) == 0
    found, printed = json.loads((tmp_path / "replay.json").read_text()), capsys.readouterr().out
    held = [entry["perturbed"] for entry in found["results"]]
    assert [len(each) for each in held] == [3, 3]
    assert found["perturbed"]["replays"] == 3
    assert found["perturbed"]["share"] == pytest.approx(np.mean(held))
    low, high = found["perturbed"]["interval_95"]
    assert low < found["perturbed"]["share"] <= high
    assert "perturbed, 3 each" in printed
    assert replay.main([*options, f"--json={tmp_path / 'plain.json'}"]) == 0
    plain = json.loads((tmp_path / "plain.json").read_text())
    assert plain["perturbed"] is None
    assert [entry["success"] for entry in plain["results"]] == [entry["success"] for entry in found["results"]]
