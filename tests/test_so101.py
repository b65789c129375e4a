"""A real third-party dataset of an SO-101, whose gripper is one moving jaw on the arm's last link, becomes a Panda's."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from cei_converters import convert
from cei_converters.dataset.metadata import Metadata
from cei_gym.embodiment import catalogue

SHARED = Path(__file__).parents[2] / "shared"
DATASET, ROBOT = SHARED / "datasets/so101_pick_v3.0", SHARED / "robots/so101"
EXAMPLE = Path(__file__).parents[1] / "examples/so101"

pytestmark = pytest.mark.skipif(not (DATASET.exists() and ROBOT.exists()), reason="needs ../shared")


@pytest.fixture(scope="module", autouse=True)
def own_robots(tmp_path_factory: pytest.TempPathFactory):
    own = tmp_path_factory.mktemp("own") / "embodiments"
    shutil.copytree(EXAMPLE, own)
    shutil.copytree(ROBOT, own / "robot")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(catalogue.FOLDERS, str(own))
        yield


def run(out: Path, *options: str, root: Path = DATASET) -> int:
    return convert.main(
        [
            "--dataset.repo_id=lab/so101",
            f"--dataset.root={root}",
            f"--joint_map={EXAMPLE / 'joint_map.yaml'}",
            "--target=Panda-PandaGripper",
            "--target_pose=-0.3,0,0",
            "--new_repo_id=me/so101",
            f"--new_root={out / 'new'}",
            f"--json={out / 'result.json'}",
            *options,
        ]
    )


def test_its_jaws_meet_where_its_pads_are(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert run(tmp_path, "--episodes=0,3") == 0
    result = json.loads((tmp_path / "result.json").read_text())
    for episode in result["results"]:
        assert episode["pad_distance_mm_mean"] < 5 and episode["fidelity"] > 0.9
        assert not episode["unreachable_frames"]
    # what is not as it was is said, and kept
    printed = capsys.readouterr().out
    reason = "as the dataset is here without its videos"
    assert f"Not carried over, {reason}: observation.images.front, observation.images.top." in printed
    assert result["dropped_features"] == dict.fromkeys(("observation.images.front", "observation.images.top"), reason)
    (note, *_) = result["notes"]["SO101-SO101Jaw"]
    assert "inertia" in note and f"note: SO101-SO101Jaw: {note}" in printed
    provenance = Metadata.load(tmp_path / "new").provenance
    assert provenance.notes == result["notes"] and provenance.source is not None
    assert provenance.source.dropped == result["dropped_features"]
    card = (tmp_path / "new/README.md").read_text()
    assert note in card and reason in card


def test_a_dataset_that_lacks_some_of_its_videos_is_refused(tmp_path: Path, complaint: Callable) -> None:
    source = Path(shutil.copytree(DATASET, tmp_path / "source"))
    (source / "videos/observation.images.top/chunk-000").mkdir(parents=True)
    assert run(tmp_path, root=source) == 1
    assert "is missing; download the dataset with its videos." in complaint()
    assert not (tmp_path / "new").exists()
