"""Fast reading of LeRobot datasets: the same samples as LeRobot's own reader, whatever a dataset holds."""

import pickle

import lerobot
import numpy as np
import pytest
import torch
from datasets import Dataset
from datasets.table import concat_tables
from lerobot.datasets import lerobot_dataset
from lerobot.datasets.dataset_reader import DatasetReader
from lerobot.datasets.io_utils import hf_transform_to_torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_policy_dp3 import fast_reader
from lerobot_policy_dp3.fast_reader import FastReader

FPS, LENGTHS = 10, (7, 2, 12)
NUMBERS = {
    "observation.state": ("float32", (5,)),
    "observation.point_cloud": ("float32", (30, 3)),
    "observation.flat_cloud": ("float32", (90,)),
    "observation.double": ("float64", (2,)),
    "observation.count": ("int64", (3,)),
    "observation.small": ("int32", (1,)),
    "observation.flags": ("bool", (2,)),
    "action": ("float32", (5,)),
}


def write(root, pictures: str | None = None) -> None:
    rng = np.random.default_rng(0)
    features = {key: {"dtype": dtype, "shape": shape, "names": None} for key, (dtype, shape) in NUMBERS.items()}
    features["observation.word"] = {"dtype": "string", "shape": (1,), "names": None}
    if pictures:
        features["observation.images.front"] = {
            "dtype": pictures,
            "shape": (32, 48, 3),
            "names": ["height", "width", "channels"],
        }
    dataset = LeRobotDataset.create("me/any", FPS, features, root=root, use_videos=pictures == "video")
    for episode, length in enumerate(LENGTHS):
        for _ in range(length):
            frame = {key: (rng.normal(size=shape) * 3).astype(dtype) for key, (dtype, shape) in NUMBERS.items()}
            if pictures:
                frame["observation.images.front"] = rng.integers(0, 255, (32, 48, 3), dtype=np.uint8)
            dataset.add_frame(frame | {"observation.word": f"word {episode}", "task": f"task {episode % 2}"})
        dataset.save_episode()
    dataset.finalize()


@pytest.fixture(scope="module")
def roots(tmp_path_factory):
    folder = tmp_path_factory.mktemp("datasets")
    for pictures in (None, "image", "video"):
        write(folder / str(pictures), pictures)
    return folder


def both(monkeypatch, root, **options) -> tuple[LeRobotDataset, LeRobotDataset]:
    made = []
    for reader in (DatasetReader, FastReader):
        monkeypatch.setattr(lerobot_dataset, "DatasetReader", reader)
        made.append(LeRobotDataset("me/any", root=root, video_backend="pyav", **options))
        assert type(made[-1].reader) is reader
    return made[0], made[1]


def same(ours: dict, theirs: dict) -> None:
    assert set(ours) == set(theirs)
    for key, value in theirs.items():
        if isinstance(value, torch.Tensor):
            assert ours[key].dtype == value.dtype, key
            torch.testing.assert_close(ours[key], value, rtol=0, atol=0, msg=key)
        else:
            assert ours[key] == value, key


WINDOWS = {key: [-0.2, 0.0, 0.1] for key in NUMBERS}


@pytest.mark.parametrize("pictures", [None, "image", "video"])
@pytest.mark.parametrize("windows", [None, WINDOWS])
@pytest.mark.parametrize("episodes", [None, [0, 2], [2]])
def test_samples_are_lerobots(monkeypatch, roots, pictures, windows, episodes):
    if windows and pictures:
        windows = {**windows, "observation.images.front": [-0.1, 0.0]}
    theirs, ours = both(monkeypatch, roots / str(pictures), delta_timestamps=windows, episodes=episodes)
    assert len(ours) == len(theirs)
    columns = ours.reader.columns
    assert set(NUMBERS) <= set(columns)
    assert "observation.word" not in columns
    for i in [0, 1, len(theirs) // 2, len(theirs) - 1, -1]:
        same(ours[i], theirs[i])
    with pytest.raises(IndexError):
        ours[len(ours)]


def test_batches_are_lerobots_in_workers_of_any_kind(monkeypatch, roots):
    theirs, ours = both(monkeypatch, roots / "None", delta_timestamps=WINDOWS)
    ours[0]
    same(pickle.loads(pickle.dumps(ours.reader)).get_item(3), theirs[3])
    batches = [
        list(torch.utils.data.DataLoader(dataset, batch_size=5, num_workers=workers))
        for dataset, workers in ((theirs, 0), (ours, 0), (ours, 2))
    ]
    for their_batch, *our_batches in zip(*batches, strict=True):
        for our_batch in our_batches:
            same(our_batch, their_batch)


def test_what_is_returned_is_a_copy(monkeypatch, roots):
    _, ours = both(monkeypatch, roots / "None", delta_timestamps=WINDOWS)
    before = ours[4]["observation.point_cloud"].clone()
    ours[4]["observation.point_cloud"].zero_()
    torch.testing.assert_close(ours[4]["observation.point_cloud"], before)


def test_tables_in_several_pieces(monkeypatch, roots):
    theirs, ours = both(monkeypatch, roots / "None", delta_timestamps=WINDOWS)
    table = ours.reader.hf_dataset
    pieces = [table.data.slice(start, length) for start, length in ((0, 4), (4, 0), (4, 9), (13, 8))]
    ours.reader.hf_dataset = Dataset(concat_tables(pieces), table.info).with_transform(hf_transform_to_torch)
    assert len(ours.reader.columns["observation.state"].chunks) > 1
    for i in range(len(theirs)):
        same(ours[i], theirs[i])


def test_rows_in_another_order_are_left_to_lerobot(monkeypatch, roots):
    theirs, ours = both(monkeypatch, roots / "None", delta_timestamps=WINDOWS)
    for dataset in (theirs, ours):
        dataset.reader.hf_dataset = dataset.reader.hf_dataset.select(range(20, -1, -1))
    assert ours.reader.columns is None
    same(ours[3], theirs[3])


def test_other_versions_of_lerobot_are_left_alone(monkeypatch):
    monkeypatch.setattr(lerobot_dataset, "DatasetReader", DatasetReader)
    monkeypatch.setattr(lerobot, "__version__", "0.7.0")
    assert not fast_reader.install()
    assert lerobot_dataset.DatasetReader is DatasetReader
    monkeypatch.setattr(lerobot, "__version__", "0.6.1")
    assert fast_reader.install()
    assert lerobot_dataset.DatasetReader is FastReader

    class Others(DatasetReader):
        pass

    monkeypatch.setattr(lerobot_dataset, "DatasetReader", Others)
    assert not fast_reader.install()
    assert lerobot_dataset.DatasetReader is Others
