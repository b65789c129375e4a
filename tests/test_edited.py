"""LeRobot's own tools edit our datasets, with nothing of ours in their process; what they make is used as the original was."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import older
import pyarrow.parquet as pq
import pytest
from conversions import record_cubes

from cei_converters import convert, replay, restore, view
from cei_converters.dataset import schema
from cei_converters.dataset.columns import encode
from cei_converters.dataset.decoding import decode_frames
from cei_converters.dataset.essentials import Remains, essentials, with_essentials
from cei_converters.dataset.metadata import Environment, Metadata
from cei_converters.dataset.records import RECORDS_PATH, Records, RecordWriter
from cei_converters.dataset.starts import find_starts
from cei_converters.dataset.step_time import StepTime, StepTimes
from cei_converters.inspection import command as inspecting
from cei_converters.sources.reader import DatasetReader
from cei_converters.view.episode import load_view
from lerobot_env_cei import CEIEnvConfig

SOURCE, TARGET = "Panda-PandaGripper", "UR5e-FourierRight"
ENVIRONMENT = f"CEI-PickCube-{TARGET}"
VIDEO, STILL, CLOUD = "observation.images.video", "observation.images.still", "observation.point_cloud"
DEPTH = "observation.depth.front"
FEW = ("--init.starts=64", "--init.basins=2", "--clouds.points=64", "--clouds.robot_points=512", "--workers=1")

OLDER: Any = {
    "records": [{"source_episode": 5}, {"source_episode": 7}],
    "environment": {"id": ENVIRONMENT, "kwargs": {"start_qpos": [[0.0] * 17]}},
    "provenance": {"source": {"repo_id": "me/panda", "embodiment": SOURCE}, "options": {"clouds": {"tau_m": 0.01}}},
}

STOCK = """
import json, sys
from lerobot.scripts import lerobot_edit_dataset
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["lerobot-edit-dataset", *arguments]
    lerobot_edit_dataset.main()
ours = [name for name in sys.modules if name.startswith(("cei_", "lerobot_policy_", "lerobot_env_"))]
assert not ours, ours
"""


def edit(*operations: Sequence[str]) -> None:
    """Let LeRobot's script do these, one after the other, in a process of its own."""
    command = [sys.executable, "-c", STOCK, json.dumps(operations)]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "HF_HUB_OFFLINE": "1"})
    assert done.returncode == 0, done.stderr[-3000:]


def of(root: Path, new: Path | None = None) -> list[str]:
    """Options: which dataset, and where to."""
    there = [] if new is None else [f"--new_repo_id=me/{new.name}", f"--new_root={new}"]
    return [f"--repo_id=me/{root.name}", f"--root={root}", *there]


def delete(*episodes: int) -> list[str]:
    return ["--operation.type=delete_episodes", f"--operation.episode_indices={list(episodes)}"]


def remove(feature: str) -> list[str]:
    return ["--operation.type=remove_feature", f"--operation.feature_names=['{feature}']"]


def merge(one: Path, other: Path, new: Path) -> list[str]:
    roots = ["--operation.repo_ids=['me/one','me/other']", f"--operation.roots=['{one}','{other}']"]
    return ["--operation.type=merge", *roots, f"--new_repo_id=me/{new.name}", f"--new_root={new}"]


def with_pictures(root: Path, out: Path) -> None:
    """The same demonstrations as seen by two more cameras, a film and pictures, by LeRobot's own writer."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    reader = DatasetReader("me/panda", root)
    features = schema.features(reader.embodiment, reader.read(0))
    camera = {"shape": (48, 64, 3), "names": ["height", "width", "channels"]}
    features |= {VIDEO: {"dtype": "video", **camera}, STILL: {"dtype": "image", **camera}}
    dataset = LeRobotDataset.create("me/rich", 20, features, root=out, robot_type=SOURCE)
    for index, episode in enumerate(reader):
        columns = encode(episode)
        for t in range(len(episode)):
            picture = np.full((48, 64, 3), (60 * index, 9 * t % 240, 100), np.uint8)
            frame = {key: values[t] for key, values in columns.items()}
            dataset.add_frame({**frame, VIDEO: picture, STILL: picture, "task": episode.task})
        dataset.save_episode()
    dataset.finalize()
    assert reader.metadata is not None
    reader.metadata.save(out)
    with RecordWriter(out) as writer:
        for index in range(len(reader)):
            writer.add(reader.record(index))
    (out / "README.md").write_text("---\nlicense: cc-by-4.0\n---\n# Rich\n")
    (out / "LICENSE").write_text("You may.")


@dataclass(frozen=True)
class Made:
    """Originals, and what LeRobot made of them.

    Attributes:
        panda: recorded, with depth images.
        rich: the same with pictures, from which `a` (two episodes) and `b` (one) are converted.
        folder: where results are, by their names.
    """

    panda: Path
    rich: Path
    a: Path
    b: Path
    folder: Path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("edited")
    panda, rich, a, b = (folder / name for name in ("panda", "rich", "a", "b"))
    record_cubes(panda, 3, 0)
    with_pictures(panda, rich)
    moving = ["--dataset.repo_id=me/rich", f"--dataset.root={rich}", f"--target={TARGET}", *FEW]
    assert convert.main([*moving, "--new_repo_id=me/a", f"--new_root={a}", "--episodes=0,2"]) == 0
    assert convert.main([*moving, "--new_repo_id=me/b", f"--new_root={b}", "--episodes=1", "--init.seed=1"]) == 0
    for name, original in (("tasks", a), ("kept", a), ("without", a), ("shorter", panda)):
        shutil.copytree(original, folder / name)
    for version in older.VERSIONS:
        older.write(folder / version, version, list(DatasetReader("me/a", a)), **OLDER)
    splits = ["--operation.type=split", '--operation.splits={"train": [1], "test": [0]}']
    edit(
        [*of(a, folder / "deleted"), *delete(0)],
        [*of(a), f"--new_root={folder / 'split'}", *splits],
        merge(a, b, folder / "merged"),
        merge(panda, panda, folder / "twice"),
        [*of(a, folder / "removed"), *remove(VIDEO)],
        [*of(a, folder / "blind"), *remove(CLOUD)],
        [*of(a, folder / "stats"), "--operation.type=recompute_stats"],
        [*of(folder / "tasks"), "--operation.type=modify_tasks", "--operation.new_task=do it"],
        [*of(folder / "kept", folder / "kept"), *delete(0)],
        [*of(folder / "without", folder / "without"), *remove("action")],
        [*of(folder / "merged", folder / "again"), *delete(1)],
        [*of(folder / "shorter", folder / "shorter"), *delete(1)],
        [*of(panda, folder / "joints"), *remove(DEPTH)],
        *([*of(folder / version, folder / f"{version}-edited"), *remove(older.OBJECTS)] for version in older.VERSIONS),
    )
    return Made(panda, rich, a, b, folder)


RESULTS = {  # name, and what its episodes are
    "deleted": [("a", 1)],
    "split/train": [("a", 1)],
    "split/test": [("a", 0)],
    "merged": [("a", 0), ("a", 1), ("b", 0)],
    "removed": [("a", 0), ("a", 1)],
    "blind": [("a", 0), ("a", 1)],
    "stats": [("a", 0), ("a", 1)],
    "tasks": [("a", 0), ("a", 1)],
    "kept": [("a", 1)],
    "again": [("a", 0), ("b", 0)],
    "shorter": [("panda", 0), ("panda", 2)],
    "joints": [("panda", 0), ("panda", 1), ("panda", 2)],
    "twice": [("panda", 0), ("panda", 1), ("panda", 2)] * 2,
}


def film(reader: DatasetReader, index: int) -> np.ndarray:
    """(T, 3, H, W) frames of an episode's video."""
    clip = reader.pictures(index).clips[VIDEO]
    return decode_frames(clip.path, clip.start_s + np.arange(reader.frames(index)) / reader.fps, int(reader.fps))


@pytest.mark.parametrize("name", RESULTS)
def test_episodes_are_the_originals(name: str, made: Made) -> None:
    reader = DatasetReader("me/edited", made.folder / name)
    assert len(reader) == len(RESULTS[name])
    assert reader.dropped == {}
    for index, (original, episode) in enumerate(RESULTS[name]):
        before = DatasetReader("me/original", made.folder / original)
        ours, theirs = reader.read(index), before.read(episode)
        for what in ("qpos", "action", "environment_state", "point_cloud_world"):
            if (name, what) != ("blind", "point_cloud_world"):
                np.testing.assert_array_equal(getattr(ours, what), getattr(theirs, what), err_msg=what)
        assert ours.task == ("do it" if name == "tasks" else theirs.task)
        assert reader.digest(index) == before.digest(episode)
        if original == "panda":
            assert set(ours.depth_m) == (set() if name == "joints" else {"front"})
            for camera, depth_m in ours.depth_m.items():
                np.testing.assert_array_equal(depth_m, theirs.depth_m[camera])
            continue
        stills = [found.pictures(i).images[STILL].to_pylist() for found, i in ((reader, index), (before, episode))]
        assert [cell["bytes"] for cell in stills[0]] == [cell["bytes"] for cell in stills[1]]
        if name != "removed":
            difference = film(reader, index).astype(int) - film(before, episode)
            assert np.abs(difference).max() <= (0 if name in ("stats", "tasks", "blind") else 5)  # encoded again


@pytest.mark.parametrize("name", RESULTS)
def test_what_a_dataset_cannot_be_used_without_is_still_known(name: str, made: Made) -> None:
    metadata = DatasetReader("me/edited", made.folder / name).metadata
    original = Metadata.load(made.folder / RESULTS[name][0][0])
    assert metadata is not None
    assert isinstance(metadata, Remains) == (name not in ("stats", "tasks"))
    assert essentials(metadata) == essentials(original)
    assert metadata.environment.id == original.environment.id
    np.testing.assert_array_equal(metadata.scene.T_world_base, original.scene.T_world_base)


def test_one_of_the_features_that_carry_it_may_be_removed(made: Made) -> None:
    assert "action" not in json.loads((made.folder / "without/meta/info.json").read_text())["features"]
    assert CEIEnvConfig(dataset=str(made.folder / "without")).gym_id == ENVIRONMENT


def replayed(root: Path, tmp_path: Path) -> list[tuple[bool, int]]:
    path = tmp_path / f"{root.name}.json"
    options = ["--dataset.repo_id=me/any", f"--dataset.root={root}", "--video_episodes=0", f"--json={path}"]
    assert replay.main(options) == 0
    return [(entry["success"], entry["steps"]) for entry in json.loads(path.read_text())["results"]]


def test_edited_datasets_replay_as_the_originals_do(made: Made, tmp_path: Path) -> None:
    assert replayed(made.folder / "merged", tmp_path) == [*replayed(made.a, tmp_path), *replayed(made.b, tmp_path)]
    assert [success for success, _ in replayed(made.folder / "shorter", tmp_path)] == [True, True]


def starts(root: Path) -> np.ndarray:
    return np.array(CEIEnvConfig(dataset=str(root)).gym_kwargs["start_qpos"])


def test_environments_start_where_the_episodes_that_are_left_do(made: Made) -> None:
    kept, first = starts(made.folder / "kept"), DatasetReader("me/a", made.a).read(1).qpos[0]
    np.testing.assert_allclose(kept, first[None], atol=1e-4)
    merged, known = starts(made.folder / "merged"), np.concatenate([starts(made.a), starts(made.b)])
    apart = np.abs(known[0] - known[1]).max()
    assert apart > 0.5 or apart < 0.25  # one motion or two, as it was converted
    np.testing.assert_allclose(merged, known if apart > 0.5 else merged, atol=1e-9)
    np.testing.assert_array_equal(starts(made.folder / "blind"), starts(made.a))
    recorded = CEIEnvConfig(dataset=str(made.folder / "shorter"))
    assert recorded.augment is False and "start_qpos" not in recorded.gym_kwargs  # at home, as before
    assert CEIEnvConfig(dataset=str(made.folder / "merged")).augment is True
    assert CEIEnvConfig(dataset=str(made.folder / "merged")).features["point_cloud"].shape == (64, 3)


def test_an_edited_dataset_of_the_hub_is_downloaded_for_where_it_starts(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from huggingface_hub.errors import EntryNotFoundError

    asked, cache = [], tmp_path / "snapshots/0"

    def download(repo_id: str, path: str, **_: Any) -> str:
        asked.append(path)
        if not (made.folder / "kept" / path).exists():
            raise EntryNotFoundError(path)
        (cache / path).parent.mkdir(parents=True, exist_ok=True)
        return str(shutil.copy(made.folder / "kept" / path, cache / path))

    def download_all(repo_id: str, **_: Any) -> str:
        asked.append("all")
        return str(shutil.copytree(made.folder / "kept", tmp_path / "snapshots/1"))

    monkeypatch.setattr("huggingface_hub.hf_hub_download", download)
    monkeypatch.setattr("huggingface_hub.snapshot_download", download_all)
    config = CEIEnvConfig(dataset="me/nowhere_here")
    assert asked == ["meta/info.json", "meta/cei.json", "all"]
    np.testing.assert_array_equal(config.gym_kwargs["start_qpos"], starts(made.folder / "kept"))


def test_starts_of_two_motions_are_not_averaged(tmp_path: Path) -> None:
    import pyarrow as pa

    rng = np.random.default_rng(0)
    motions, which = np.array([[0.0, 1.0, -1.0], [0.6, 1.0, -1.0]]), [0, 1, 0, 0, 1, 0, 1]
    first = motions[which] + rng.uniform(-0.04, 0.04, (7, 3))
    states = np.repeat(first, 3, axis=0) + np.tile([[0.0], [5.0], [9.0]], (7, 1))  # where it goes does not matter
    (tmp_path / "data/chunk-000").mkdir(parents=True)
    for file, rows in (("file-000", slice(0, 9)), ("file-001", slice(9, None))):
        columns = {
            "observation.state": states[rows].astype(np.float32).tolist(),
            "frame_index": [0, 1, 2] * (len(states[rows]) // 3),
        }
        pq.write_table(pa.table(columns), tmp_path / f"data/chunk-000/{file}.parquet")
    expected = [np.median(first[np.array(which) == motion], axis=0) for motion in (0, 1)]
    np.testing.assert_allclose(find_starts(tmp_path), expected, atol=1e-4)


def test_an_edited_dataset_converts_again_and_says_what_it_has_lost(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = tmp_path / "third"
    options = ["--dataset.repo_id=me/merged", f"--dataset.root={made.folder / 'merged'}", "--target=IIWA-Inspire", *FEW]
    assert convert.main([*options, "--new_repo_id=me/third", f"--new_root={out}", "--episodes=2"]) == 0
    printed = capsys.readouterr().out
    assert "its license is not carried over" in printed and "cei-restore --dataset.root=" in printed
    reader = DatasetReader("me/third", out)
    assert reader.read(0).point_cloud_world is not None
    assert reader.record(0)["source_episode"] == 2 and "seed" not in reader.record(0)
    assert reader.metadata is not None and reader.metadata.environment.id == "CEI-PickCube-IIWA-Inspire"


def test_it_is_looked_at(made: Made, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    dataset = ["--dataset.repo_id=me/kept", f"--dataset.root={made.folder / 'kept'}"]
    assert load_view(DatasetReader("me/kept", made.folder / "kept"), 0).sides[0].role == "dataset"
    assert inspecting.main(dataset) == 0
    beside = ["--source.repo_id=me/rich", f"--source.root={made.rich}", f"--sheet={tmp_path / 'beside.png'}"]
    capsys.readouterr()
    assert view.main([*dataset, *beside]) == 1  # which episode of the source it was nobody knows any more
    error = capsys.readouterr().err
    assert "does not say what its episode 0 was converted from" in error and "cei-restore --dataset.root=" in error
    assert replay.main([*dataset, *beside[:2], "--video_episodes=1", f"--video={tmp_path / 'film.mp4'}"]) == 1
    assert "does not say what its episode 0 was converted from" in capsys.readouterr().err


# -- merging ------------------------------------------------------------------------------------------------------


def test_lerobot_merges_only_what_belongs_together(made: Made) -> None:
    from lerobot.datasets.feature_utils import features_equal_for_merge

    metadata = Metadata.load(made.a)
    plain = schema.features(DatasetReader("me/a", made.a).embodiment, DatasetReader("me/a", made.a).read(0))

    def merges(**change: Any) -> bool:
        features = [with_essentials(plain, each) for each in (metadata, replace(metadata, **change))]
        return features_equal_for_merge(*features)

    scene, environment = metadata.scene, metadata.environment
    assert merges() and merges(total_episodes=7, provenance=Metadata.load(made.b).provenance)
    assert merges(environment=replace(environment, kwargs={**environment.kwargs, "start_qpos": [[0.0] * 17]}))
    elsewhere = scene.T_world_base.copy()
    elsewhere[0, 3] += 0.001
    assert not merges(scene=replace(scene, T_world_base=elsewhere))
    assert not merges(scene=replace(scene, cameras=()))
    assert not merges(environment=Environment(f"CEI-StackCube-{TARGET}", environment.kwargs))
    assert not merges(environment=replace(environment, kwargs={"depth_noise": "kinect"}))
    assert not merges(clouds={**(metadata.clouds or {}), "tau_m": 0.01})
    assert not merges(clouds=None)


# -- cei-restore --------------------------------------------------------------------------------------------------


def restored(root: Path, *options: str) -> int:
    return restore.main(["--dataset.repo_id=me/restored", f"--dataset.root={root}", *options])


@pytest.fixture
def copied(made: Made, tmp_path: Path) -> Callable[[str], Path]:
    return lambda name: Path(shutil.copytree(made.folder / name, tmp_path / name.replace("/", "-")))


def test_what_was_deleted_from_is_restored(made: Made, copied: Callable[[str], Path], tmp_path: Path) -> None:
    shutil.copytree(made.folder / "kept_old", tmp_path / "kept_old")  # where LeRobot leaves it
    root = copied("kept")
    assert restored(root) == 0
    metadata, original = Metadata.load(root), Metadata.load(made.a)
    assert metadata.provenance == original.provenance and metadata.merged == ()
    assert metadata.total_episodes == 1
    np.testing.assert_allclose(metadata.environment.kwargs["start_qpos"], starts(made.folder / "kept"))
    (found,), known = Records(root), Records(made.a)
    assert found == {**known[1], "restored_from": {"repo_id": "kept_old", "episode": 1}}
    assert found["source_episode"] == 2
    card = (root / "README.md").read_text()
    assert "license: cc-by-4.0" in card and "1 episodes" in card and "1 of `kept_old`" in card
    assert original.provenance.command in card
    assert (root / "LICENSE").read_text() == "You may."
    assert not (root / "meta/quality.png").exists()  # it shows others, too
    shown = load_view(DatasetReader("me/kept", root), 0, DatasetReader("me/rich", made.rich))
    np.testing.assert_array_equal(shown.sides[0].demonstration.index, 2)
    assert sorted(path.name for path in root.iterdir()) == ["LICENSE", "README.md", "data", "meta", "videos"]


def test_what_was_merged_is_restored_from_both(made: Made, copied: Callable[[str], Path]) -> None:
    root = copied("merged")
    assert restored(root, f"--original={made.a},{made.b}") == 0
    metadata = Metadata.load(root)
    assert metadata.provenances == (Metadata.load(made.a).provenance, Metadata.load(made.b).provenance)
    found = list(Records(root))
    assert [(each["source_episode"], each["provenance"], each["restored_from"]["repo_id"]) for each in found] == [
        (0, 0, "a"),
        (2, 0, "a"),
        (1, 1, "b"),
    ]
    card = (root / "README.md").read_text()
    timed = [len(StepTimes.of(each).each) for each in found]
    assert timed == [len(episode) for episode in DatasetReader("me/merged", root)]  # as `rich` had from `panda`
    assert metadata.step_time_s == StepTime.of(found, 20) and metadata.step_time_s.steps == sum(timed)
    assert "### Part 1" in card and "2 of `a`, 1 of `b`" in card and card.count("`me/rich`") >= 2
    fewer = copied("again")  # from what was restored, edited once more
    assert restored(fewer, f"--original={root}") == 0
    found = [(each["source_episode"], each["provenance"], each["restored_from"]) for each in Records(fewer)]
    assert found == [
        (0, 0, {"repo_id": "merged", "episode": 0}),
        (1, 1, {"repo_id": "merged", "episode": 2}),
    ]


def test_a_removed_feature_keeps_the_picture_and_may_be_the_joints(made: Made, copied: Callable[[str], Path]) -> None:
    for name in ("blind", "without"):
        root = copied(name)
        assert restored(root, f"--original={made.a}") == 0
        assert (root / "meta/quality.png").read_bytes() == (made.a / "meta/quality.png").read_bytes()
        assert Metadata.load(root).environment == Metadata.load(made.a).environment
        assert [record["source_episode"] for record in Records(root)] == [0, 2]


@pytest.mark.parametrize("version", older.VERSIONS)
def test_an_older_layout_is_restored(version: str, made: Made, copied: Callable[[str], Path]) -> None:
    root = copied(f"{version}-edited")  # a feature less: all that LeRobot's tools can do to it
    assert restored(root, f"--original={made.folder / version}") == 0
    reader = DatasetReader("me/older", root)
    assert [reader.source_episode(i) for i in range(2)] == [5, 7]
    assert reader.metadata is not None and reader.metadata.clouds == {"tau_m": 0.01}
    assert "| `observation.point_cloud` | float32 | 64x3 | point, xyz_m |" in (root / "README.md").read_text()
    assert CEIEnvConfig(dataset=str(root)).augment is True


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("merged", ["--original=a"], "1 of 3 episodes of .*, the first of them 2, are in none of a: name all"),
        ("merged", ["--original=a,kept"], "was edited itself, and has nothing to restore from"),
        ("merged", ["--original=a,nothing"], "nothing"),
        ("merged", ["--original=a,./a"], "has 2 that are called a, by which records name them"),
        ("merged", [], "name what .* was made from with --original; there is no merged_old beside it"),
        ("tasks", ["--original=a"], "meta/cei.json exists; if it is not what belongs there, remove it first"),
        ("shorter", ["--original=a"], "2 of 2 episodes of .* are in none of a"),
    ],
)
def test_what_cannot_be_restored_gets_one_line_and_stays_as_it_is(
    name: str,
    options: list[str],
    says: str,
    made: Made,
    copied: Callable[[str], Path],
    capsys: pytest.CaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import re

    monkeypatch.chdir(made.folder)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    root = copied(name)
    before = {path: path.stat().st_mtime_ns for path in root.rglob("*")}
    capsys.readouterr()
    assert restored(root, *options) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and re.search(says, error), error
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*")} == before


# -- metadata of another state of the dataset --------------------------------------------------------------------


def test_metadata_that_does_not_fit_is_not_believed(
    made: Made, copied: Callable[[str], Path], capsys: pytest.CaptureFixture
) -> None:
    """As when files are copied by hand, or an edited dataset is pushed over the one it was made from."""
    root = copied("kept")
    for path in ("meta/cei.json", RECORDS_PATH):
        shutil.copy(made.a / path, root / path)
    capsys.readouterr()
    reader = DatasetReader("me/kept", root)
    printed = capsys.readouterr().out
    assert f"meta/cei.json of {root} is of 2 episodes, not of its 1: ignored." in printed
    assert f"{RECORDS_PATH} of {root} is of 2 episodes, not of its 1: ignored." in printed
    assert isinstance(reader.metadata, Remains) and reader.record(0) == {}
    np.testing.assert_allclose(starts(root), DatasetReader("me/a", made.a).read(1).qpos[:1], atol=1e-4)


def test_a_record_of_another_episode_is_refused(
    made: Made, copied: Callable[[str], Path], complaint: Callable, tmp_path: Path
) -> None:
    root = copied("stats")
    lines = (root / RECORDS_PATH).read_text().splitlines()
    (root / RECORDS_PATH).write_text("\n".join(lines[::-1]) + "\n")
    options = ["--dataset.repo_id=me/stats", f"--dataset.root={root}", "--target=IIWA-Inspire", *FEW]
    assert convert.main([*options, "--dry_run"]) == 1
    assert f"line 1 of {root / RECORDS_PATH} is of another episode than episode 0" in complaint()


def test_metadata_of_another_dataset_is_refused(made: Made, copied: Callable[[str], Path], complaint: Callable) -> None:
    root = copied("stats")
    metadata = Metadata.load(root)
    replace(metadata, clouds={**(metadata.clouds or {}), "tau_m": 0.1}).save(root)
    assert replay.main(["--dataset.repo_id=me/stats", f"--dataset.root={root}", "--video_episodes=0"]) == 1
    assert "meta/cei.json and meta/info.json disagree about clouds" in complaint()


def test_a_source_of_another_robot_is_refused(made: Made, capsys: pytest.CaptureFixture, tmp_path: Path) -> None:
    beside = ["--source.repo_id=me/b", f"--source.root={made.b}", f"--sheet={tmp_path / 'x.png'}"]
    assert view.main(["--dataset.repo_id=me/a", f"--dataset.root={made.a}", *beside]) == 1
    assert f"was converted from {SOURCE}; --source is of {TARGET}" in capsys.readouterr().err
