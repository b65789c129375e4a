"""Whatever is wrong with what users bring: one clear line, an exit code, no hang, and nothing written."""

import faulthandler
import os
import shutil
import signal
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from malformed import CARD, LAUGHS, ROBOT, Case, corpus, write_dataset, write_hand
from malformed_sources import write_hdf5, write_zarr

from cei_converters import cli, convert, pads, replay
from cei_converters.dataset.license import source_license
from cei_converters.sources.formats import open_source
from cei_converters.sources.reader import DatasetReader

CASES = corpus(seed=0)
TIMEOUT_S = 240  # a hang, on however busy a machine


@dataclass
class ReadConfig:
    """Read all of a dataset, as a conversion does."""

    root: str  # Its folder.


def read(config: ReadConfig) -> None:
    reader = DatasetReader("me/pick", config.root)
    reader.check_videos(range(len(reader)))
    for index in range(len(reader)):
        demonstration = reader.read(index)
        assert len(demonstration) == reader.frames(index)
        assert np.isfinite(demonstration.qpos).all()
        reader.pictures(index)


@dataclass
class ReadOtherConfig:
    """Read all of another format, as a conversion does."""

    root: str  # Its file or folder.
    joint_map: str | None = None  # Which of its columns are which joints.


def read_other(config: ReadOtherConfig) -> None:
    source = open_source(
        "me/pick", config.root, embodiment=None if config.joint_map else ROBOT, joint_map=config.joint_map
    )
    for index in range(len(source)):
        assert np.isfinite(source.read(index).qpos).all()
        source.carry(index)


def other(*options: str) -> int:
    return cli.run(ReadOtherConfig, read_other, list(options), prog="read", example="")


def convert_to(out: Path, folder: Path, *options: str) -> int:
    args = ["--dataset.repo_id=me/pick", f"--dataset.root={folder}", "--target=IIWA-Inspire", "--new_repo_id=me/out"]
    return convert.main([*args, f"--new_root={out}", "--init.starts=8", "--init.basins=1", *options])


COMMANDS = {
    "pads": lambda folder, out: pads.main([f"--end_effector={folder / 'hand.yaml'}", f"--output={out}.png"]),
    "convert": lambda folder, out: convert_to(out, folder),
    "calibrate": lambda folder, out: convert_to(out, folder, f"--calibration={folder / 'cameras.yaml'}"),
    "replay": lambda folder, _: replay.main(["--dataset.repo_id=me/pick", f"--dataset.root={folder}"]),
    "hdf5": lambda folder, _: other(f"--root={folder / 'demo.hdf5'}"),
    "zarr": lambda folder, _: other(f"--root={folder / 'demo.zarr'}", f"--joint_map={folder / 'map.yaml'}"),
    "read": lambda folder, _: cli.run(ReadConfig, read, [f"--root={folder}"], prog="read", example=""),
}


@pytest.fixture(scope="module")
def valid(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Kind to folder."""
    folder = tmp_path_factory.mktemp("valid")
    kinds = {"urdf": folder / "urdf", "mjcf": folder / "mjcf", "dataset": folder / "pick"}
    kinds |= {kind: folder / kind for kind in ("hdf5", "zarr")}
    write_hand(kinds["urdf"], "hand.urdf")
    write_hand(kinds["mjcf"], "hand.xml")
    write_dataset(kinds["dataset"])
    write_hdf5(kinds["hdf5"])
    write_zarr(kinds["zarr"])
    return kinds


@contextmanager
def deadline() -> Iterator[None]:
    """Fail a test that takes too long; end the process, saying where it is, if Python does not get to it."""

    def late(*_: object) -> None:
        pytest.fail(f"not done after {TIMEOUT_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(TIMEOUT_S)
    faulthandler.dump_traceback_later(TIMEOUT_S + 60, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def contents(folder: Path) -> dict[str, object]:
    """Path to what is there, links not followed."""
    found: dict[str, object] = {}
    for path in (Path(at, name) for at, folders, files in os.walk(folder) for name in (*folders, *files)):
        there = path.readlink() if path.is_symlink() else path.read_bytes() if path.is_file() else "folder"
        found[str(path.relative_to(folder))] = there
    return found


@pytest.mark.parametrize(
    ("kind", "command"), [("urdf", "pads"), ("mjcf", "pads"), ("dataset", "read"), ("hdf5", "hdf5"), ("zarr", "zarr")]
)
def test_what_is_spoilt_is_valid_before(valid: dict[str, Path], tmp_path: Path, kind: str, command: str) -> None:
    assert COMMANDS[command](valid[kind], tmp_path / "out") == 0


def test_the_corpus_is_large_and_the_same_each_time() -> None:
    names = Counter(map(str, CASES))
    assert max(names.values()) == 1, names.most_common(3)
    assert len(CASES) >= 150
    assert [str(case) for case in corpus(seed=0)] == list(names)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_malformed_input_is_refused(
    case: Case, valid: dict[str, Path], tmp_path: Path, capfd: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    # below two folders, so that what climbs out of one is still seen
    folder = Path(shutil.copytree(valid[case.kind], tmp_path / "sub" / "in"))
    case.spoil(folder)
    assert contents(folder) != contents(valid[case.kind])
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    before = contents(tmp_path)
    capfd.readouterr()
    with deadline():
        code = COMMANDS[case.through](folder, tmp_path / "out")
    output = capfd.readouterr()
    assert "Traceback" not in output.out + output.err
    if case.may_pass and code == 0:
        assert {path: found for path, found in contents(tmp_path).items() if not path.endswith("out.png")} == before
        return
    assert code not in (0, None)
    assert output.err.startswith("error: "), output.err
    assert output.err.count("\n") == 1, output.err
    assert len(output.err) < 4000  # as long as the list of all environments
    assert case.says.lower() in output.err.lower()
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "card",
    [
        b"---\nlicense: \xff\n---\n",
        b"---\nlicense: [a\n---\n",
        b"---\n- a\n---\n",
        f"---\n{LAUGHS}license: *a9\n---\n".encode(),
    ],
    ids=["no UTF-8", "no YAML", "a list", "billion laughs"],
)
def test_a_broken_card_names_no_license(tmp_path: Path, card: bytes) -> None:
    (tmp_path / CARD).write_bytes(card)
    with deadline():
        assert source_license(tmp_path) == {}
