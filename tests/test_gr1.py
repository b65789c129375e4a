"""A real third-party dataset: a GR-1's right arm and hand become a gripper and another hand, and its joint map is the right one."""

from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from cei_converters import convert
from cei_converters.dataset.records import Records
from cei_converters.sources.binding import bind
from cei_converters.sources.formats import open_source
from cei_converters.sources.joint_map import load_joint_map
from cei_gym.embodiment import catalogue, load_embodiment
from cei_gym.kinematics import KinematicTree

GR1 = Path(__file__).parents[2] / "shared/datasets/gr1_pick_n_place_v2.0"
EXAMPLE = Path(__file__).parents[1] / "examples/gr1"
ROBOT, EYE = "GR1Right-GR1RightHand", "observation.images.ego_view"
ARM = range(7)

pytestmark = pytest.mark.skipif(not GR1.exists(), reason="needs ../shared/datasets")


@pytest.fixture(scope="module", autouse=True)
def own_robots(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(catalogue.FOLDERS, str(EXAMPLE))
        patch.setenv("HF_LEROBOT_HOME", str(tmp_path_factory.mktemp("home")))
        yield


def states(episode: int) -> np.ndarray:
    table = pq.read_table(GR1 / f"data/chunk-000/episode_{episode:06d}.parquet")
    return np.stack(table["observation.state"].to_numpy())


def pictures(episode: int) -> np.ndarray:
    with av.open(GR1 / f"videos/chunk-000/{EYE}/episode_{episode:06d}.mp4") as video:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)])


def qpos(state: np.ndarray) -> np.ndarray:
    mapped = bind(load_joint_map(EXAMPLE / "joint_map.yaml"), load_embodiment(ROBOT), [f"motor_{i}" for i in range(44)])
    return mapped.qpos(state)


def test_limits_say_where_the_arm_and_the_hand_are() -> None:
    """Of all windows of 7 and 6 columns that move, these alone are within the arm's and the hand's limits."""
    body = load_embodiment(ROBOT)
    state = np.concatenate([states(episode) for episode in range(5)])
    independent = body.coupled.independent
    hand = [body.joint_names.index(f"R_{name}_joint") for name in HAND]
    for joints, first in ((independent[independent < body.n_arm], 22), (np.array(hand), 29)):
        slack = 0.2 * (body.upper[joints] - body.lower[joints])  # fingers are pressed past their limits
        fits = []
        for start in range(44 - len(joints) + 1):
            window = state[:, start : start + len(joints)]
            inside = (window >= body.lower[joints] - slack) & (window <= body.upper[joints] + slack)
            if inside.mean() > 0.995 and np.ptp(window, axis=0).min() > 0.5:
                fits.append(start)
        assert fits == [first]


HAND = (
    "pinky_proximal",
    "ring_proximal",
    "middle_proximal",
    "index_proximal",
    "thumb_proximal_pitch",
    "thumb_proximal_yaw",
)


def test_the_video_says_that_order_and_signs_are_right() -> None:
    """A camera is fitted to where the hand appears; with any joint's sign or two neighbours exchanged, none fits as well."""
    body = load_embodiment(ROBOT)
    tree, link = KinematicTree(body), body.body_id("R_middle_proximal_link")
    seen, at = [], []
    for episode in range(5):
        frames, state = pictures(episode)[::5], states(episode)[::5]
        still = np.median(frames, axis=0)
        dark = (np.abs(frames - still).max(axis=3) > 40) & (frames.max(axis=3) < 60)  # black, and not always there
        dark[:, :48] = dark[:, 208:] = dark[:, :, :90] = False  # black bars, and the left hand
        for mask, joints in zip(dark, qpos(state), strict=False):
            if mask.sum() > 150:
                seen.append(np.argwhere(mask).mean(axis=0)[::-1])
                at.append(joints)
    pixels, joints = np.array(seen), np.array(at)
    assert len(pixels) > 300
    forward = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # a camera that looks along x

    def misfit(joints: np.ndarray) -> float:
        """Median distance of the hand from where the best camera sees it, pixels."""
        points = tree.forward(joints)[:, link, :3, 3]

        def error(camera: np.ndarray) -> np.ndarray:
            seen = Rotation.from_rotvec(camera[3:6]).apply(points - camera[:3], inverse=True)
            depth = np.maximum(seen[:, 2:], 0.05)
            return (128 + camera[6] * seen[:, :2] / depth - pixels).ravel()

        best = np.inf
        for tilt in (0.6, 0.9, 1.2):
            R = Rotation.from_matrix(forward) * Rotation.from_rotvec([-tilt, 0, 0])
            start = [0.1, 0, 0.7, *R.as_rotvec(), 150.0]
            found = least_squares(error, start, loss="soft_l1", f_scale=5, max_nfev=200)
            best = min(best, float(np.median(np.linalg.norm(found.fun.reshape(-1, 2), axis=1))))
        return best

    right = misfit(joints)
    assert right < 8.5
    for joint in ARM:
        other = joints.copy()
        other[:, joint] *= -1
        assert misfit(other) > 1.05 * right, f"the sign of {body.joint_names[joint]}"
    for joint in ARM[:-1]:
        other = joints.copy()
        other[:, [joint, joint + 1]] = other[:, [joint + 1, joint]]
        assert misfit(other) > 1.05 * right, f"{body.joint_names[joint]} and the next"


@pytest.mark.parametrize("target", ["Panda-PandaGripper", "UR5e-Inspire"])
def test_it_converts_hand_to_gripper_and_hand_to_hand(
    target: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    root = tmp_path / "out"
    args = ["--dataset.repo_id=nvidia/gr1", f"--dataset.root={GR1}", f"--joint_map={EXAMPLE / 'joint_map.yaml'}"]
    args += [f"--target={target}", "--new_repo_id=me/gr1", f"--new_root={root}", "--episodes=4", "--allow_unreachable"]
    args += ["--transfer.stretch=1", "--init.starts=64", "--init.basins=8"]
    assert convert.main(args) == 0
    said = capsys.readouterr().out
    assert "gr1_pick_n_place_v2.0 declares observation.images.egoview but has no file of it: left out." in said or (
        "still show the source robot: observation.images.ego_view" in said
    )
    made = open_source("me/gr1", root).read(0)
    body = load_embodiment(target)
    assert len(made) == 328 and made.fps == 20
    assert (made.qpos >= body.lower - 1e-6).all() and (made.qpos <= body.upper + 1e-6).all()
    record = Records(root)[0]["alignment"]
    assert record["pad_distance_mm_mean"] < 25  # a hand opens wider than a gripper
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("me/gr1", root, video_backend="pyav")
    recorded = pictures(4)
    for t in (0, 150, 327):  # untouched, so pixel for pixel
        shown = (dataset[t][EYE].permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
        np.testing.assert_array_equal(shown, recorded[t])
    card = (root / "README.md").read_text()
    assert "| license of the source | `LICENSE` |" in card
    assert "Apache License" in (root / "LICENSE").read_text()
    assert "still show" in card and EYE in card
