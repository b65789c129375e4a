"""Datasets are what stock LeRobot loads, lose nothing, and are written whole or not at all."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import older
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lerobot.utils.utils import flatten_dict

from cei_converters.dataset import schema
from cei_converters.dataset.columns import encode
from cei_converters.dataset.episodes import EpisodeWriter
from cei_converters.dataset.license import source_license
from cei_converters.dataset.metadata import Environment, Metadata, Source
from cei_converters.dataset.provenance import collect, fingerprint
from cei_converters.dataset.records import Records
from cei_converters.dataset.rows import EPISODE, read_rows
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.sources.reader import DatasetReader
from cei_gym.demonstration import Camera, Demonstration, Scene
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError

REPO_ID = "me/pick"
ROBOT = "Panda-PandaGripper"
HEIGHT, WIDTH = 18, 24


def demonstration(frames: int, seed: int = 0) -> Demonstration:
    rng = np.random.default_rng(seed)
    body = load_embodiment(ROBOT)
    qpos = rng.uniform(body.lower, body.upper, (frames, len(body.lower)))
    K = np.array([[20.0, 0.0, 12.0], [0.0, 20.0, 9.0], [0.0, 0.0, 1.0]])
    cameras = tuple(Camera(name, WIDTH, HEIGHT, K, np.eye(4)) for name in ("front", "side"))
    return Demonstration(
        embodiment=ROBOT,
        fps=20.0,
        qpos=qpos,
        action=qpos + 0.01,
        scene=Scene(np.eye(4), cameras, np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])),
        task="pick the cube",
        depth_m={c.name: rng.uniform(0, 65.5, (frames, HEIGHT, WIDTH)).astype(np.float32) for c in cameras},
        point_cloud_world=rng.normal(size=(frames, 1024, 3)).astype(np.float32),
        environment_state=rng.normal(size=(frames, 2)),
        environment_state_names=("cube.x_m", "cube.y_m"),
    )


EPISODES = (demonstration(7), demonstration(5, seed=1))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "new" / "pick"
    source = Source(repo_id="me/other", embodiment="IIWA-Inspire", license="cc-by-4.0")
    environment = Environment("CEI-PickCube-Panda-PandaGripper", {"seed_cameras": True})
    provenance = collect({"target": ROBOT, "transfer": {"steps": 100}}, source=source)
    with DatasetWriter(REPO_ID, root, environment=environment, provenance=provenance) as writer:
        for seed, episode in enumerate(EPISODES):
            alignment = {"pad_distance_mm_mean": 1.0 + seed, "unreachable_frames": [], "bad": float("nan")}
            writer.add(episode, {"seed": seed, "alignment": alignment})
    return root


def test_stock_lerobot_loads_and_iterates(root: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from torch.utils.data import DataLoader

    dataset = LeRobotDataset(REPO_ID, root, delta_timestamps={"action": [0.0, 0.05]})
    assert (dataset.num_episodes, dataset.num_frames, dataset.meta.robot_type) == (2, 12, ROBOT)
    assert dataset.meta.depth_keys == ["observation.depth.front", "observation.depth.side"]
    batches = list(DataLoader(dataset, batch_size=4))
    depth_mm = np.concatenate([batch["observation.depth.front"] for batch in batches])
    expected_mm = np.rint(1000 * np.concatenate([e.depth_m["front"] for e in EPISODES]))[:, None]
    np.testing.assert_array_equal(depth_mm, expected_mm)
    assert batches[0]["observation.point_cloud"].shape == (4, 3072)
    np.testing.assert_array_equal(
        batches[0]["observation.point_cloud"].reshape(4, 1024, 3), EPISODES[0].point_cloud_world[:4]
    )
    assert dataset.features["observation.point_cloud"]["info"] == {
        "shape": [1024, 3],
        "columns": ["x_m", "y_m", "z_m"],
        "frame": "world",
    }
    assert batches[0]["action"].shape == (4, 2, 9)
    assert batches[0]["task"][0] == "pick the cube"
    assert "observation.point_cloud" not in dataset.meta.stats  # of 3072 single coordinates they would say nothing
    for key in set(dataset.features) - {"timestamp", "observation.point_cloud"}:
        assert np.isfinite(dataset.meta.stats[key]["mean"]).all(), key
    assert dataset.features["observation.state"]["names"][6:8] == ["joint7.pos_rad", "finger_joint1.pos_m"]


def test_equals_what_lerobots_own_writer_writes(root: Path, tmp_path: Path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    written = json.loads((root / "meta/info.json").read_text())["features"]
    features = schema.features(load_embodiment(ROBOT), EPISODES[0])
    assert all(
        written[key].items() >= {**feature, "shape": [*feature["shape"]]}.items() for key, feature in features.items()
    )
    features = {key: {**written[key], "shape": feature["shape"]} for key, feature in features.items()}
    stock = LeRobotDataset.create(
        REPO_ID, fps=20, features=features, root=tmp_path / "stock", robot_type=ROBOT, use_videos=False
    )
    for episode in EPISODES:
        for frame in range(len(episode)):
            values = {key: column[frame] for key, column in encode(episode).items()}
            stock.add_frame({**values, "task": episode.task})
        stock.save_episode()
    stock.finalize()
    info, stats = (
        [json.loads((folder / "meta" / file).read_text()) for folder in (root, stock.root)]
        for file in ("info.json", "stats.json")
    )
    assert info[0] == info[1]
    stats[1].pop("observation.point_cloud")
    ours, theirs = (flatten_dict(each) for each in stats)
    assert ours.keys() == theirs.keys()
    for key in ours:
        np.testing.assert_allclose(ours[key], theirs[key], rtol=1e-6, err_msg=key)
    for file in ("data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet", "meta/tasks.parquet"):
        ours, theirs = (pq.read_table(folder / file) for folder in (root, stock.root))
        theirs = theirs.select([name for name in theirs.column_names if "stats/observation.point_cloud/" not in name])
        assert ours.schema == theirs.schema, file
        assert ours.equals(theirs), file
    described = [
        json.loads(pq.read_schema(folder / "data/chunk-000/file-000.parquet").metadata[b"huggingface"])["info"]
        for folder in (root, stock.root)
    ]
    assert described[0]["features"] == described[1]["features"]
    assert pq.read_metadata(root / "data/chunk-000/file-000.parquet").num_row_groups == len(EPISODES)


def test_large_datasets_go_into_several_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    monkeypatch.setattr("lerobot.datasets.feature_utils.DEFAULT_DATA_FILE_SIZE_IN_MB", 0.2)
    with DatasetWriter(REPO_ID, tmp_path / "pick") as writer:
        for episode in (*EPISODES, EPISODES[0]):
            writer.add(episode)
    files = sorted((tmp_path / "pick/data").rglob("*.parquet"))
    assert len(files) > 1
    assert max(file.stat().st_size for file in files) < 0.2 * 1024**2
    assert len(LeRobotDataset(REPO_ID, tmp_path / "pick")) == 19
    reader = DatasetReader(REPO_ID, tmp_path / "pick")
    np.testing.assert_array_equal(reader.read(2).point_cloud_world, EPISODES[0].point_cloud_world)


@pytest.mark.parametrize("lost", ["file", "end", "episode"])
def test_what_a_disk_loses_is_not_published(lost: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def finalize(self: EpisodeWriter) -> None:
        completed(self)
        for path in tmp_path.rglob("data/*/*.parquet"):
            if lost == "file":
                path.unlink()
            elif lost == "end":
                path.write_bytes(path.read_bytes()[:-8])
            else:
                pq.write_table(pq.ParquetFile(path).read_row_group(0), path)

    completed = EpisodeWriter.finalize
    monkeypatch.setattr(EpisodeWriter, "finalize", finalize)
    with (
        pytest.raises(OSError, match=r"that were written|cannot be read back"),
        DatasetWriter(REPO_ID, tmp_path / "x") as w,
    ):
        for episode in EPISODES:
            w.add(episode)
    assert list(tmp_path.iterdir()) == []


def test_read_back_equals_what_was_written(root: Path) -> None:
    reader = DatasetReader(REPO_ID, root)
    assert (len(reader), reader.fps, reader.frames(1)) == (2, 20.0, 5)
    for got, wrote in zip(reader, EPISODES, strict=True):
        np.testing.assert_array_equal(got.qpos, wrote.qpos.astype(np.float32))
        np.testing.assert_array_equal(got.action, wrote.action.astype(np.float32))
        np.testing.assert_array_equal(got.point_cloud_world, wrote.point_cloud_world)
        np.testing.assert_array_equal(got.environment_state, wrote.environment_state.astype(np.float32))
        for camera, depth_m in wrote.depth_m.items():
            assert got.depth_m[camera].dtype == np.float32
            np.testing.assert_array_equal(np.rint(got.depth_m[camera] * 1000), np.rint(depth_m * 1000))
        assert (got.task, got.environment_state_names) == (wrote.task, wrote.environment_state_names)
    assert (reader.carried, reader.dropped) == ({}, {})


def test_second_conversion_round_trips_exactly(root: Path, tmp_path: Path) -> None:
    reader = DatasetReader(REPO_ID, root)
    with DatasetWriter(REPO_ID, tmp_path / "copy") as writer:
        for episode in reader:
            writer.add(episode)
    for ours, copy in zip(reader, DatasetReader(REPO_ID, tmp_path / "copy"), strict=True):
        np.testing.assert_array_equal(ours.depth_m["side"], copy.depth_m["side"])
        np.testing.assert_array_equal(ours.qpos, copy.qpos)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    episodes=st.lists(st.integers(0, 5), min_size=1, max_size=40),
    group=st.integers(1, 8),
    statistics=st.booleans(),
    columns=st.none() | st.lists(st.sampled_from(["value", EPISODE, "absent"]), unique=True),
)
def test_rows_of_an_episode_are_those_that_a_filter_finds(
    episodes: list[int], group: int, statistics: bool, columns: list[str] | None, tmp_path: Path
) -> None:
    path = tmp_path / f"{len(list(tmp_path.iterdir()))}.parquet"
    table = pa.table({EPISODE: episodes, "value": range(len(episodes))})
    pq.write_table(table, path, row_group_size=group, write_statistics=statistics)
    for episode in range(7):
        found = read_rows(path, episode, columns)
        expected = pq.read_table(path, filters=[(EPISODE, "==", episode)])
        if columns is not None:
            expected = expected.select([name for name in columns if name in expected.column_names])
        assert found.equals(expected)


def test_metadata_round_trips(root: Path) -> None:
    metadata = Metadata.load(root)
    assert metadata.embodiment == ROBOT
    assert metadata.environment == Environment("CEI-PickCube-Panda-PandaGripper", {"seed_cameras": True})
    assert metadata.provenance.source.repo_id == "me/other"
    assert metadata.provenance.versions["lerobot"]
    assert metadata.provenance.options["transfer"] == {"steps": 100}
    records = Records(root)
    assert [record["seed"] for record in records] == [0, 1]
    assert (len(records), records[-1], records[:1]) == (2, list(records)[1], [records[0]])
    assert records[0]["alignment"]["bad"] is None
    with pytest.raises(IndexError):
        records[2]
    np.testing.assert_array_equal(metadata.scene.cameras[1].K, EPISODES[0].scene.cameras[1].K)
    raw = json.loads((root / "meta/cei.json").read_text())
    assert "y down" in raw["conventions"]["camera"]


@pytest.mark.parametrize("version", older.VERSIONS)
def test_older_layouts_are_read(version: str, tmp_path: Path) -> None:
    environment = {"id": "CEI-PickCube-Panda-PandaGripper", "kwargs": {"start_qpos": [[0.0] * 9]}}
    source = {"repo_id": "me/other", "embodiment": "IIWA-Inspire"}
    provenance = {"source": source, "options": {"clouds": {"points": 1024, "tau_m": 0.01}}}
    known = [{"seed": 4, "source_episode": 1}, {"seed": 5, "source_episode": 0}]
    older.write(tmp_path / "older", version, EPISODES, known, environment, provenance)
    reader = DatasetReader(REPO_ID, tmp_path / "older")
    for got, wrote in zip(reader, EPISODES, strict=True):
        np.testing.assert_array_equal(got.point_cloud_world, wrote.point_cloud_world)
        np.testing.assert_array_equal(got.environment_state, wrote.environment_state.astype(np.float32))
        assert got.environment_state_names == wrote.environment_state_names
    assert [reader.record(i) for i in range(2)] == known
    assert [reader.source_episode(i) for i in range(2)] == [1, 0]
    assert reader.metadata is not None and reader.metadata.clouds == {"points": 1024, "tau_m": 0.01}
    assert reader.metadata.environment == Environment(environment["id"], environment["kwargs"])
    assert reader.dropped == {}
    with DatasetWriter(REPO_ID, tmp_path / "newer") as writer:
        for episode in reader:
            writer.add(episode)
    newer = json.loads((tmp_path / "newer/meta/info.json").read_text())["features"]
    assert newer["observation.point_cloud"]["shape"] == [3072]
    assert "observation.environment_state" not in newer and "privileged.environment_state" in newer
    for got, wrote in zip(DatasetReader(REPO_ID, tmp_path / "newer"), EPISODES, strict=True):
        np.testing.assert_array_equal(got.point_cloud_world, wrote.point_cloud_world)


def test_policies_are_given_the_state_of_objects_only_where_it_is_asked_for(tmp_path: Path) -> None:
    from lerobot.utils.feature_utils import dataset_to_policy_features

    for name, key in (("default", "privileged.environment_state"), ("asked", "observation.environment_state")):
        with DatasetWriter(REPO_ID, tmp_path / name, state_key=schema.state_key(name == "asked")) as writer:
            writer.add(EPISODES[0])
        features = json.loads((tmp_path / name / "meta/info.json").read_text())["features"]
        given = {found for found in dataset_to_policy_features(features) if "environment_state" in found}
        assert given == {"observation.environment_state"} & {key}
        (episode,) = DatasetReader(REPO_ID, tmp_path / name)
        np.testing.assert_array_equal(episode.environment_state, EPISODES[0].environment_state.astype(np.float32))
        card = (tmp_path / name / "README.md").read_text()
        assert ("no policy is given it" in card) == (name == "default")
        assert ("LeRobot's ACT and Diffusion take it" in card) == (name == "asked")


def test_card_is_complete(root: Path) -> None:
    card = (root / "README.md").read_text()
    assert source_license(root) == {"license": "cc-by-4.0"}
    for text in (
        "LeRobot",
        "cross-embodiment",
        "data/*/*.parquet",
        "pad_distance_mm_mean",
        "| 1.5 | 1 | 2 |",
    ):
        assert text in card
    assert "`--transfer.steps`" in card
    assert "More Information" not in card


def test_fingerprint_follows_content(root: Path, tmp_path: Path) -> None:
    with DatasetWriter(REPO_ID, tmp_path / "a") as writer:
        writer.add(EPISODES[0])
    assert fingerprint(root) == fingerprint(root) != fingerprint(tmp_path / "a")


def test_nothing_is_overwritten(root: Path) -> None:
    before = fingerprint(root)
    with pytest.raises(CEIError, match="already exists"), DatasetWriter(REPO_ID, root):
        pass
    assert fingerprint(root) == before
    assert [path.name for path in root.parent.iterdir()] == ["pick"]


def test_failure_in_the_middle_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), DatasetWriter(REPO_ID, tmp_path / "new" / "pick") as writer:
        writer.add(EPISODES[0])
        raise RuntimeError
    with pytest.raises(CEIError, match="no episode"), DatasetWriter(REPO_ID, tmp_path / "new" / "pick"):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fps": 10.0}, "fps is 10.0 but the dataset's is 20.0"),
        ({"depth_m": {}}, "observation.depth.front has shape None"),
        (
            {"scene": replace(EPISODES[0].scene, T_world_base=np.diag([-1.0, -1.0, 1.0, 1.0]))},
            "base, cameras",
        ),
        ({"depth_m": {c: np.full((5, HEIGHT, WIDTH), 66.0) for c in ("front", "side")}}, "65.535"),
    ],
)
def test_episodes_must_match(tmp_path: Path, change: dict, message: str) -> None:
    with (
        pytest.raises(CEIError, match=message) as error,
        DatasetWriter(REPO_ID, tmp_path / "pick") as writer,
    ):
        writer.add(EPISODES[0])
        writer.add(replace(EPISODES[1], **change))
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []
