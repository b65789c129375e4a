"""Channels of a demonstration: checked when it is made, treated everywhere as they are declared. The wrist's wrench is the newest one."""

import json
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from conversions import record_cubes

from cei_converters import convert
from cei_converters.dataset import schema
from cei_converters.dataset.columns import encode
from cei_converters.sources.reader import DatasetReader
from cei_gym.augmentation import Handling, Offset, displace
from cei_gym.channels import Channel, OnDisplacement, OnTransfer, channel, channels, check_channels
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError
from cei_gym.transfer import Transfer

SOURCE, TARGET = "Panda-PandaGripper", "UR5e-PandaGripper"
T = 6
KEY = "observation.wrench"


def demonstration(**changes: Any) -> Demonstration:
    body, rng = load_embodiment(SOURCE), np.random.default_rng(0)
    qpos = body.home + np.linspace(0, 0.05, T)[:, None]
    scene = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))
    made = Demonstration(
        SOURCE,
        20.0,
        qpos,
        qpos,
        scene,
        environment_state=rng.normal(size=(T, 2)),
        environment_state_names=("cube.x_m", "cube.y_m"),
        wrench=rng.normal(size=(T, 6)),
    )
    return replace(made, **changes)


# -- what a demonstration may be -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("environment_state", np.zeros((3, 2)), "environment_state has shape (3, 2); it should be (6, 2)"),
        ("environment_state", np.zeros((T, 3)), "environment_state has 3 entries and 2 names"),
        ("environment_state", np.full((T, 2), np.inf), "environment_state is not finite at frame 0, entry 0"),
        ("wrench", np.zeros((T, 5)), "wrench has shape (6, 5); it should be (6, 6)"),
        ("wrench", np.zeros(T), "wrench has shape (6,); it should be (6, 6)"),
        ("wrench", np.zeros((T, 6), int), "wrench is of int64; it should be of float32"),
        ("action", np.zeros((T, 3)), "action has shape (6, 3); it should be (6, 9)"),
        (
            "point_cloud_world",
            np.zeros((T - 1, 10, 3)),
            "point_cloud_world has shape (5, 10, 3); it should be (6, 10, 3)",
        ),
        (
            "depth_m",
            {"front": np.zeros((T, 4))},
            "depth_m of camera front has shape (6, 4); it should be (6, 4, width)",
        ),
        ("rgb", {"front": np.zeros((T, 4, 4, 3))}, "rgb of camera front is of float64; it should be of uint8"),
        (
            "rgb",
            {"front": np.zeros((T, 4, 4, 4), np.uint8)},
            "rgb of camera front has shape (6, 4, 4, 4); it should be (6, 4, 4, 3)",
        ),
    ],
)
def test_a_channel_that_is_not_as_declared_is_refused(name: str, value: Any, message: str) -> None:
    with pytest.raises(CEIError) as error:
        demonstration(**{name: value})
    assert str(error.value).startswith(f"episode 0: {message}")


def test_cameras_may_differ_in_size() -> None:
    depth_m = {"front": np.ones((T, 4, 5), np.float32), "left": np.ones((T, 2, 3), np.float32)}
    assert list(demonstration(depth_m=depth_m).depth_m) == ["front", "left"]


def test_every_channel_is_cut() -> None:
    pictures = {"front": np.arange(T * 12, dtype=np.uint8).reshape(T, 2, 2, 3)}
    depth_m = {"front": np.arange(T * 4, dtype=np.float32).reshape(T, 2, 2)}
    whole = demonstration(
        rgb=pictures, depth_m=depth_m, point_cloud_world=np.random.default_rng(1).normal(size=(T, 8, 3))
    )
    frames = np.array([0, 0, 2, 5])
    cut = whole.at(frames)
    for name, declared in channels(Demonstration).items():
        for camera, values in declared.arrays(getattr(whole, name)).items():
            np.testing.assert_array_equal(declared.arrays(getattr(cut, name))[camera], values[frames])


# -- a channel of one's own ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pushed:
    """Something with a channel that nobody else knows."""

    push: np.ndarray | None = field(
        default=None,
        metadata=channel((2,), "N", OnTransfer.KEEP, OnDisplacement.MOVE, names=("x_N", "y_N")),
    )


def test_a_declaration_is_all_there_is_to_a_channel() -> None:
    assert channels(Pushed) == {"push": Channel((2,), "N", OnTransfer.KEEP, OnDisplacement.MOVE, names=("x_N", "y_N"))}
    check_channels(Pushed(np.zeros((3, 2))), 3, "here")
    with pytest.raises(CEIError, match=r"^here: push has shape \(4, 2\); it should be \(3, 2\), a row for each frame"):
        check_channels(Pushed(np.zeros((4, 2))), 3, "here")


# -- the wrist's wrench ---------------------------------------------------------------------------------------------


def test_a_wrench_is_stored_with_its_names_unit_and_frame() -> None:
    made = demonstration()
    feature = schema.features(load_embodiment(SOURCE), made)[KEY]
    assert feature["shape"] == (6,) and feature["names"][0] == "force_x_N" and feature["names"][-1] == "torque_z_Nm"
    assert feature["info"] == {"unit": "N, N m", "frame": "wrist sensor"}
    np.testing.assert_array_equal(encode(made)[KEY], made.wrench.astype(np.float32))  # pyright: ignore


def test_a_transfer_keeps_what_is_of_the_world_and_drops_what_is_of_the_source() -> None:
    made = demonstration()
    transfer = Transfer(made_body := load_embodiment(SOURCE), load_embodiment(TARGET))
    moved, _ = transfer(made)
    assert made_body.name == SOURCE and moved.wrench is None
    assert moved.environment_state is not None and moved.environment_state_names == made.environment_state_names


def test_what_a_hand_feels_stays_where_objects_are_moved() -> None:
    made = demonstration()
    handling = Handling(np.zeros(T, bool), np.zeros((T, 3)), np.tile(np.eye(4), (T, 1, 1)), np.zeros(T, bool))
    moved = displace(made, handling, Offset(0.1, 0.0, 0.0), whole=3)
    np.testing.assert_array_equal(moved.wrench, made.wrench)  # pyright: ignore
    np.testing.assert_allclose(moved.environment_state[:, 0], made.environment_state[:, 0] + 0.1)  # pyright: ignore


def test_at_rest_the_wrist_carries_the_hand() -> None:
    env = gym.make(f"CEI-PickCube-{SOURCE}", clouds=False, sensors=["wrench"])
    env.reset(seed=0)
    inner: Any = env.unwrapped
    for _ in range(3):
        env.step(inner.embodiment.home.astype(np.float32))
    wrench = inner.channels()["wrench"]
    hand = [b for b in range(inner.model.nbody) if inner.model.body(b).name.startswith("gripper0_right")]
    weight_N = 9.81 * inner.model.body_mass[hand].sum()
    assert np.linalg.norm(wrench[:3]) == pytest.approx(weight_N, rel=0.05)
    env.close()


def test_before_an_episode_there_is_nothing_to_have() -> None:
    env: Any = gym.make(f"CEI-PickCube-{SOURCE}", clouds=False).unwrapped
    with pytest.raises(CEIError, match=r"^no episode has begun: call reset\(\) before channels\(\)\.$"):
        env.channels()
    env.close()


def test_an_unknown_sensor_is_refused() -> None:
    with pytest.raises(CEIError, match=r"^unknown sensor 'touch'\..*Valid: wrench"):
        gym.make(f"CEI-PickCube-{SOURCE}", clouds=False, sensors=["touch"])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("channels") / "felt"
    record_cubes(root, 1, 0, "--sensors=[wrench]")
    return root


def test_a_recorded_wrench_is_read_back(recorded: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    episode = DatasetReader("me/felt", recorded).read(0)
    wrench = episode.wrench
    assert wrench is not None and wrench.shape == (len(episode), 6) and wrench.std(axis=0).min() > 0
    stored = LeRobotDataset("me/felt", recorded)
    np.testing.assert_array_equal(stored[5][KEY].numpy(), wrench[5].astype(np.float32))
    assert stored.meta.features[KEY]["names"] == list(channels(Demonstration)["wrench"].names)


def test_a_conversion_drops_it_and_says_so(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    new = tmp_path / "new"
    options = [f"--dataset.root={recorded}", f"--target={TARGET}", "--new_repo_id=me/new", f"--new_root={new}"]
    assert convert.main(["--dataset.repo_id=me/felt", *options]) == 0
    assert f"Not carried over, of the source robot: {KEY}." in capsys.readouterr().out
    assert KEY not in json.loads((new / "meta/info.json").read_text())["features"]
    assert f"| `{KEY}` | of the source robot |" in (new / "README.md").read_text()
    assert json.loads((new / "meta/cei.json").read_text())["environment"]["kwargs"].keys() == {"start_qpos"}
    assert DatasetReader("me/new", new).read(0).wrench is None


def test_somebody_elses_wrench_is_not_taken_for_ours(recorded: Path, tmp_path: Path) -> None:
    """Other names may mean other units and axes."""
    theirs = shutil.copytree(recorded, tmp_path / "theirs")
    info = json.loads((theirs / "meta/info.json").read_text())
    info["features"][KEY]["names"] = ["fx", "fy", "fz", "tx", "ty", "tz"]
    (theirs / "meta/info.json").write_text(json.dumps(info))
    reader = DatasetReader("me/theirs", theirs)
    assert reader.read(0).wrench is None and reader.dropped == {KEY: "of the source robot"}
