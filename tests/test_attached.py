"""What goes with a hand that holds nothing is a tool, or what a mask has left of the robot, and no obstacle."""

import json
from pathlib import Path

import numpy as np
import pytest

from cei_converters import convert
from cei_gym.pointcloud.attached import attached

FRAMES = 20
ROOT = Path(__file__).parents[1]
EGG = ROOT.parent / "shared/datasets/demogen_egg.zarr"


def path(step_m: float) -> np.ndarray:
    """(T, 4, 4) a hand that moves along x and turns about z."""
    T = np.tile(np.eye(4), (FRAMES, 1, 1))
    angle = np.linspace(0, 1, FRAMES)
    T[:, 0, 0] = T[:, 1, 1] = np.cos(angle)
    T[:, 1, 0] = np.sin(angle)
    T[:, 0, 1] = -T[:, 1, 0]
    T[:, 0, 3] = step_m * np.arange(FRAMES)
    return T


@pytest.fixture(scope="module")
def tool() -> np.ndarray:
    """(P, 3) points in the hand's frame, 2 to 10 cm from it."""
    return np.random.default_rng(0).uniform([-0.01, -0.01, 0.02], [0.01, 0.01, 0.1], (200, 3))


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    """(P, 3) a plate along the hand's way: wherever the hand is, some of it is at the same place of the hand."""
    x, y = np.meshgrid(np.arange(-0.3, 0.6, 0.01), np.arange(-0.3, 0.3, 0.01))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, -0.05)], axis=1)


def seen(T_hand: np.ndarray, tool: np.ndarray, table: np.ndarray) -> list[np.ndarray]:
    """For each frame the points of both, the tool's first, each off by a millimetre or so."""
    random = np.random.default_rng(1)
    clouds = [np.concatenate([tool @ T[:3, :3].T + T[:3, 3], table]) for T in T_hand]
    return [cloud + random.normal(0, 0.001, cloud.shape) for cloud in clouds]


def found(T_hand: np.ndarray, clouds: list[np.ndarray], free: np.ndarray | None = None) -> list[np.ndarray]:
    return attached(clouds, T_hand, T_hand[:, :3, 3], np.ones(FRAMES, bool) if free is None else free, 0.2)


def test_a_tool_is_and_a_table_along_the_way_is_not(tool: np.ndarray, table: np.ndarray) -> None:
    T_hand = path(0.02)
    for its in found(T_hand, seen(T_hand, tool, table)):
        assert its[: len(tool)].mean() > 0.99
        assert its[len(tool) :].mean() < 0.001


def test_a_hand_that_stays_tells_nothing(tool: np.ndarray, table: np.ndarray) -> None:
    T_hand = path(0.0)
    assert not np.concatenate(found(T_hand, seen(T_hand, tool, table))).any()


def test_what_is_picked_up_on_the_way_is_not(tool: np.ndarray, table: np.ndarray) -> None:
    """An object stands where the hand comes by in the middle, and goes with it from there."""
    T_hand = path(0.02)
    lies = np.concatenate([np.repeat(T_hand[10:11], 10, axis=0), T_hand[10:]])
    assert not np.concatenate(found(T_hand, seen(lies, tool, table))).any()


def test_what_the_hand_is_known_to_hold_tells_nothing(tool: np.ndarray, table: np.ndarray) -> None:
    T_hand = path(0.02)
    assert not np.concatenate(found(T_hand, seen(T_hand, tool, table), np.zeros(FRAMES, bool))).any()


def test_nothing_near_is_nothing(table: np.ndarray) -> None:
    T_hand = path(0.02)
    for clouds in ([np.zeros((0, 3))] * FRAMES, [table + 5.0] * FRAMES):
        assert [len(its) for its in found(T_hand, clouds)] == [len(cloud) for cloud in clouds]
        assert not np.concatenate(found(T_hand, clouds)).any()


@pytest.mark.skipif(not EGG.exists(), reason="needs ../shared/datasets")
def test_a_spatula_is_nothing_to_keep_clear_of_and_a_conversion_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A real Panda holds it throughout, and its recording does not say that it holds anything."""
    found = tmp_path / "found.json"
    arguments = ["--dataset.repo_id=demogen/egg", f"--dataset.root={EGG}", "--episodes=0,2", "--target=UR5e-Inspire"]
    more = [f"--joint_map={ROOT / 'examples/egg/joint_map.yaml'}", f"--json={found}", "--dry_run"]
    assert convert.main(arguments + more) == 0
    for entry in json.loads(found.read_text())["results"]:
        assert entry["penetration_mm_max"] < 3
        assert entry["tool_points_mean"] > 100
    assert "note: in episodes 0, 2 the source's hand has something with it all the time" in capsys.readouterr().out
