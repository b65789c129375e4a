"""What a dataset says of how it came about: all of its content, names but no paths; and that nothing else is gone on with, or uploaded."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import killed
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from malformed import CALIBRATION, write_dataset, write_hand
from other_formats import write_zarr
from PIL import Image

import cei_gym
from cei_converters import convert, record
from cei_converters.conversion import shard
from cei_converters.conversion.config import ConvertConfig
from cei_converters.dataset.metadata import Metadata, plain
from cei_converters.dataset.provenance import command_line, fingerprint, git_commit, published
from cei_gym.embodiment import fingerprint as identity
from cei_gym.embodiment import load_embodiment
from cei_gym.errors import CEIError

ROBOT = killed.ROBOT
BODY = load_embodiment(ROBOT)


# -- fingerprints --------------------------------------------------------------------------------------------------------


def write_hdf5(path: Path, last: float = 0.0) -> None:
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps(
            {"env_name": "Lift", "env_kwargs": {"control_freq": 20, "robots": ["Panda"]}}
        )
        for i in range(2):
            qpos, obs = killed.demonstration(i).qpos.copy(), data.create_group(f"demo_{i}/obs")
            qpos[-1, 0] += last
            obs["robot0_joint_pos"], obs["robot0_gripper_qpos"] = qpos[:, :7], qpos[:, 7:]
            actions = np.zeros((len(qpos), 7))
            actions[:, 6] = -1.0
            data[f"demo_{i}/actions"] = actions


def write_demogen(root: Path) -> None:
    qpos = [killed.demonstration(i).qpos for i in range(2)]
    write_zarr(root, np.concatenate(qpos)[:, :8], [*np.cumsum([*map(len, qpos)])])


def write_lerobot(root: Path) -> None:
    killed.write_source(root)
    (root / "images" / "front").mkdir(parents=True)
    (root / "images" / "front" / "frame.png").write_bytes(b"x")
    (root / "LICENSE").write_text("yours")


@contextmanager
def changed(path: Path) -> Iterator[None]:
    """A file with one byte more."""
    before = path.read_bytes()
    path.write_bytes(before + b" ")
    try:
        yield
    finally:
        path.write_bytes(before)


@pytest.mark.parametrize("write", [write_lerobot, write_demogen])
def test_a_folders_fingerprint_is_that_of_each_of_its_files(write: Callable[[Path], None], tmp_path: Path) -> None:
    root = tmp_path / "source"
    write(root)
    before, files = fingerprint(root), [path for path in root.rglob("*") if path.is_file()]
    assert len(files) > 3
    for path in files:
        with changed(path):
            assert fingerprint(root) != before, path
        path.rename(path.with_name("renamed"))
        assert fingerprint(root) != before, path
        path.with_name("renamed").rename(path)
        os.utime(path, (0, 0))
    assert fingerprint(root) == before  # whenever they were written
    for name in ("._file-000.parquet", ".DS_Store"):
        (files[0].parent / name).write_text("of another system")
    assert fingerprint(root) == before
    shutil.copytree(root, tmp_path / "copy")
    (tmp_path / "disk").mkdir()
    for folder in [path for path in (tmp_path / "copy").iterdir() if path.is_dir()]:  # as where data is on another disk
        folder.rename(tmp_path / "disk" / folder.name)
        folder.symlink_to(tmp_path / "disk" / folder.name)
    assert fingerprint(tmp_path / "copy") == before
    (tmp_path / "disk" / "data" / "back").symlink_to(tmp_path / "disk" / "data")
    assert fingerprint(tmp_path / "copy") == before


def test_a_files_fingerprint_is_that_of_its_bytes_and_nothing_has_none(tmp_path: Path) -> None:
    write_hdf5(tmp_path / "a.hdf5")
    before = fingerprint(tmp_path / "a.hdf5")
    shutil.copyfile(tmp_path / "a.hdf5", tmp_path / "b.hdf5")
    assert fingerprint(tmp_path / "b.hdf5") == before
    with changed(tmp_path / "a.hdf5"):
        assert fingerprint(tmp_path / "a.hdf5") != before
    write_hdf5(tmp_path / "c.hdf5", last=1e-9)
    assert fingerprint(tmp_path / "c.hdf5") != before
    (tmp_path / "empty").mkdir()
    for nothing in ("empty", "none"):
        with pytest.raises(CEIError, match="has no files"):
            fingerprint(tmp_path / nothing)
    (tmp_path / "empty" / "link").symlink_to("nowhere")
    with pytest.raises(CEIError, match="cannot be read"):
        fingerprint(tmp_path / "empty")


@pytest.fixture
def hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with an end-effector of one's own, `Hand`."""
    folder = tmp_path / "robots" / "end_effectors"
    write_hand(folder, "hand.xml")
    (folder / "hand.yaml").rename(folder / "Hand.yaml")
    monkeypatch.setenv("CEI_GYM_EMBODIMENTS", str(folder.parent))
    load_embodiment.cache_clear()
    yield folder
    load_embodiment.cache_clear()


def hand_identity() -> str:
    load_embodiment.cache_clear()
    return identity(load_embodiment("UR5e-Hand"))


HAND_CHANGES: dict[str, tuple[str, str, str]] = {
    "a pad": ("Hand.yaml", "palmar: [0.0, -1.0, 0.0]", "palmar: [0.0, -1.0, 0.1]"),
    "a pose": ("Hand.yaml", "home: {left: 0.0}", "home: {left: 0.01}"),
    "a speed": ("Hand.yaml", "max_velocity: {left: 0.2}", "max_velocity: {left: 0.3}"),
    "physics": ("Hand.yaml", "mass_kg: 0.1", "mass_kg: 0.2"),
    "a joint's range": ("hand.xml", 'axis="0 1 0" range="0 0.04"', 'axis="0 1 0" range="0 0.05"'),
    "an included file": ("assets.xml", 'file="finger.stl"', 'file="finger.stl" scale="1 1 1.1"'),
}


@pytest.mark.parametrize("what", HAND_CHANGES)
def test_an_embodiment_is_told_by_all_that_it_is_made_of(what: str, hand: Path) -> None:
    file, old, new = HAND_CHANGES[what]
    before, text = hand_identity(), (hand / file).read_text()
    assert old in text
    (hand / file).write_text(text.replace(old, new))
    assert hand_identity() != before


def test_an_embodiment_is_the_same_wherever_its_files_are(hand: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import trimesh

    before = hand_identity()
    (hand / "Hand.yaml").write_text("# a comment\n" + (hand / "Hand.yaml").read_text())
    shutil.move(hand.parent, hand.parent.with_name("elsewhere"))
    monkeypatch.setenv("CEI_GYM_EMBODIMENTS", str(hand.parent.with_name("elsewhere")))
    assert hand_identity() == before
    mesh = hand.parent.with_name("elsewhere") / "end_effectors" / "finger.stl"
    trimesh.creation.box((0.02, 0.0101, 0.05)).export(mesh)
    assert hand_identity() != before


# -- what is gone on with ------------------------------------------------------------------------------------------------


@dataclass
class Job:
    """A conversion: its arguments, and each file that it is made of, with what the refusal calls it."""

    args: list[str]
    files: dict[Path, str] = field(default_factory=dict)


def lerobot_job(folder: Path) -> Job:
    write_lerobot(folder / "source")
    files = [next((folder / "source").glob("data/*/*.parquet")), folder / "source/images/front/frame.png"]
    files += [folder / "source" / name for name in ("README.md", "LICENSE")]
    return Job(killed.arguments(folder / "source", folder / "out"), dict.fromkeys(files, "me/pick"))


def hdf5_job(folder: Path) -> Job:
    write_hdf5(folder / "source.hdf5")
    (folder / "cameras.yaml").write_text(yaml.safe_dump(CALIBRATION))
    args = killed.arguments(
        folder / "source.hdf5", folder / "out", f"--source={ROBOT}", f"--calibration={folder / 'cameras.yaml'}"
    )
    return Job(args, {folder / "source.hdf5": "me/pick", folder / "cameras.yaml": "the calibration"})


def zarr_job(folder: Path) -> Job:
    write_demogen(folder / "source.zarr")
    groups = [{"joints": "arm", "columns": {"start": 0, "end": 7}}, {"joints": ["finger_joint1"], "columns": ["7"]}]
    (folder / "map.yaml").write_text(yaml.safe_dump({"embodiment": ROBOT, "joints": groups, "fps": 20}))
    args = killed.arguments(folder / "source.zarr", folder / "out", f"--joint_map={folder / 'map.yaml'}")
    files = dict.fromkeys((path for path in (folder / "source.zarr").rglob("*") if path.name[0] != "."), "me/pick")
    return Job(args, {p: n for p, n in files.items() if p.is_file()} | {folder / "map.yaml": "the joint map"})


@pytest.fixture
def job(request: pytest.FixtureRequest, tmp_path: Path) -> Job:
    return request.param(tmp_path)


def interrupted_after(shards: int, monkeypatch: pytest.MonkeyPatch, args: list[str]) -> int:
    add, added = shard.ShardWriter.add, []

    def counted(self: shard.ShardWriter, converted: shard.Converted) -> None:
        added.append(converted)
        if len(added) > shards:
            raise KeyboardInterrupt
        add(self, converted)

    with monkeypatch.context() as patch:
        patch.setattr(shard.ShardWriter, "add", counted)
        return convert.main(args)


@pytest.mark.parametrize("job", [lerobot_job, hdf5_job, zarr_job], indirect=True, ids=["lerobot", "hdf5", "zarr"])
def test_what_has_changed_is_neither_gone_on_with_nor_uploaded(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    uploaded: list[Path] = []
    monkeypatch.setattr("cei_converters.dataset.hub.push", lambda root, *_, **__: uploaded.append(root) or "there")
    monkeypatch.setenv("HF_TOKEN", "hf_of_a_test")
    resume = [*job.args, "--resume", "--push_to_hub"]

    def refuses_what_has_changed(anew: str) -> None:
        for path, name in job.files.items():
            with changed(path):
                assert convert.main(resume) == 1, path
            error = capsys.readouterr().err
            assert f"--resume: {name} has changed since the conversion began{anew}" in error, path
            assert error.count("\n") == 1
        assert convert.main([*resume, "--transfer.points=32"]) == 1
        assert "--resume: --transfer.points was 64, now it is 32; give what was given before" in capsys.readouterr().err
        assert convert.main([arg.replace("me/out", "me/other") for arg in resume]) == 1
        assert "--resume: --new_repo_id was me/out, now it is me/other" in capsys.readouterr().err
        assert not uploaded

    assert interrupted_after(1, monkeypatch, job.args) == 130
    capsys.readouterr()
    refuses_what_has_changed(f"; to begin anew, remove {tmp_path / '.out.partial'}.")
    moved = tmp_path / "moved"  # the same content elsewhere, under other names
    moved.mkdir()
    there = []
    for arg in resume:
        option, _, value = arg.partition("=")
        if option in ("--dataset.root", "--joint_map", "--calibration"):
            elsewhere = moved / f"again{Path(value).suffix}"
            shutil.copytree(value, elsewhere) if Path(value).is_dir() else shutil.copyfile(value, elsewhere)
            arg = f"{option}={elsewhere}"
        there.append(arg)
    assert convert.main(there) == 0, capsys.readouterr().err
    assert uploaded == [tmp_path / "out"]
    uploaded.clear()
    capsys.readouterr()
    refuses_what_has_changed(f", or remove {tmp_path / 'out'}.")
    assert convert.main(resume) == 0
    assert uploaded == [tmp_path / "out"]
    assert "is finished; nothing is left to do but to upload it." in capsys.readouterr().out


def test_another_robot_of_the_same_name_is_not_gone_on_with(
    hand: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    killed.write_source(tmp_path / "source")
    args = killed.arguments(tmp_path / "source", tmp_path / "out", "--target=UR5e-Hand", "--episodes=0-1")
    args = [arg for arg in args if arg != "--target=UR5e-PandaGripper"]
    assert interrupted_after(1, monkeypatch, args) == 130

    def refused() -> None:
        for what in ("a pad", "an included file"):
            file, old, new = HAND_CHANGES[what]
            text = (hand / file).read_text()
            (hand / file).write_text(text.replace(old, new))
            load_embodiment.cache_clear()
            capsys.readouterr()
            assert convert.main([*args, "--resume"]) == 1
            assert "--resume: the target embodiment has changed since the conversion began" in capsys.readouterr().err
            (hand / file).write_text(text)
            load_embodiment.cache_clear()

    refused()
    assert convert.main([*args, "--resume"]) == 0
    refused()


# -- names, not paths ----------------------------------------------------------------------------------------------------

SECRETS = ("secretlab", "secret.user", "secrettoken", "secretkey")


@pytest.fixture
def secret(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder whose name nobody should learn, in more than one way of writing it."""
    folder = tmp_path / "secretlab" / "project=secretkey" / "~secret.user" / "a, secretlab; b"
    folder.mkdir(parents=True)
    monkeypatch.setenv("HF_TOKEN", "hf_secrettoken")
    monkeypatch.setenv("HOME", str(tmp_path / "secretlab"))
    monkeypatch.chdir(folder)
    return folder


def everything(root: Path) -> dict[str, bytes]:
    """Name to what is in each file of a dataset: its bytes, and what those of tables and pictures stand for."""
    found: dict[str, bytes] = {}
    for path in sorted(root.rglob("*")):
        if path.is_file():
            text = path.read_bytes()
            if path.suffix == ".parquet":
                table = pq.read_table(path)
                words = [column for column in table.columns if not pa.types.is_floating(column.type)]
                text += str(pq.read_metadata(path).metadata).encode() + str(table.schema).encode()
                text += b"".join(str(column.to_pylist()).encode() for column in words)
            elif path.suffix == ".png":
                text += str(Image.open(path).info).encode()
            found[f"{path.relative_to(root)}"] = text
    return found


def check_nothing_is_told(root: Path) -> None:
    for name, content in everything(root).items():
        for word in SECRETS:
            assert word.encode() not in content, f"{name} tells {word}"


def test_a_converted_dataset_tells_no_path(secret: Path, capsys: pytest.CaptureFixture) -> None:
    source = secret / "pick"
    write_dataset(source)
    (source / "cameras.yaml").rename(secret / "cameras.yaml")
    data = next(source.glob("data/*/*.parquet"))
    table = pq.read_table(data)
    pictures = {name: table[name] for name in table.column_names if pa.types.is_struct(table[name].type)}
    assert pictures
    for name, column in pictures.items():  # as recorders leave them
        cells = [
            {"bytes": cell["bytes"], "path": f"{secret}/{name}/{i}.png"} for i, cell in enumerate(column.to_pylist())
        ]
        at = table.column_names.index(name)
        table = table.set_column(at, table.schema.field(at), pa.array(cells, column.type))
    pq.write_table(table, data)
    assert b"secretlab" in everything(source)[str(data.relative_to(source))]
    args = [
        *("--dataset.repo_id=me/pick", f"--dataset.root={source}", "--target=IIWA-Inspire", "--new_repo_id=me/out"),
        *(
            "--new_root=../out",
            f"--json={secret}/x=y.json",
            f"--calibration=~/{(secret / 'cameras.yaml').relative_to(Path.home())}",
        ),
        *("--init.starts=8", "--init.basins=1", "--allow_unreachable", "--transfer.unreachable_mm=999"),
    ]
    assert convert.main(args) == 0, capsys.readouterr().err
    root = secret.parent / "out"
    check_nothing_is_told(root)
    made = Metadata.load(root)
    assert made.provenance.source is not None and made.provenance.source.root_name == "pick"
    assert made.provenance.options["calibration"] == "cameras.yaml"
    assert made.provenance.inputs["calibration"].startswith("sha256:")
    command = made.provenance.command
    assert command.startswith("cei-convert --dataset.repo_id=me/pick --dataset.root=pick --target=IIWA-Inspire")
    assert "--calibration=cameras.yaml" in command and "--allow_unreachable=true" in command
    for incidental in ("json", "new_root"):
        assert incidental not in command and incidental not in made.provenance.options
    assert command in (root / "README.md").read_text()
    tables = [pq.read_table(path) for path in root.glob("data/*/*.parquet")]
    paths = [
        cell["path"]
        for table in tables
        for name in pictures
        if name in table.column_names
        for cell in table[name].to_pylist()
    ]
    assert paths and all(path == Path(path).name for path in paths)


def test_a_recorded_dataset_tells_no_path(secret: Path, capsys: pytest.CaptureFixture) -> None:
    root = secret / "recorded"
    options = ["--env=CEI-PickCube-Panda-PandaGripper", "--episodes=1", "--variation=0.5", "--repo_id=me/recorded"]
    assert record.main([*options, f"--root={root}", "--json=~/secretkey=x.json"]) == 0, capsys.readouterr().err
    assert (Path.home() / "secretkey=x.json").is_file()
    check_nothing_is_told(root)
    provenance = Metadata.load(root).provenance
    given = {"env": "CEI-PickCube-Panda-PandaGripper", "repo_id": "me/recorded", "episodes": 1, "variation": 0.5}
    assert provenance.options == {**given, "seed": 0, "colours": False, "fixed_rate": False, "privileged_state": False}
    assert provenance.command == "cei-record " + " ".join([options[0], options[3], options[1], options[2]])


@pytest.mark.parametrize(
    "path",
    [
        "/home/secret/x.yaml",
        "~/secret/x.yaml",
        "../secret/x.yaml",
        "a=/secret/x.yaml",
        "https://me:secret@host/x.yaml",
        "secret/",
    ],
)
def test_of_a_path_its_last_part_is_published_however_it_is_written(path: str) -> None:
    from cei_converters.cli import DatasetConfig

    config = ConvertConfig(
        DatasetConfig("me/pick", Path(path)),
        "IIWA-Inspire",
        new_root=Path(path),
        calibration=Path(path),
        json=Path(path),
    )
    told = f"{published(config)} {command_line('cei-convert', config)}"
    name = Path(path).name
    assert "secret" not in told.replace(name, "")
    assert published(config)["calibration"] == published(config)["dataset"]["root"] == name


def test_a_command_that_is_published_is_the_one_that_makes_the_dataset() -> None:
    import shlex

    from cei_converters.cli import parse

    args = [
        "--dataset.repo_id=me/pick",
        "--target=IIWA-Inspire",
        "--new_repo_id=me/out",
        "--episodes=0, 3",
        "--init=given",
    ]
    args += ["--init.qpos=[0.1,0.2]", "--clouds.colours=false", "--workers=3", "--verify", "--min_quality=0.25"]
    config: Any = parse(ConvertConfig, args, "cei-convert", "")
    prog, *again = shlex.split(command_line("cei-convert", config))
    assert prog == "cei-convert"
    same: Any = parse(ConvertConfig, again, "cei-convert", "")
    assert plain(same) == plain(config) | {"workers": None}


def test_a_commit_is_dirty_where_code_has_changed_not_where_figures_have(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*args: str) -> str:
        who = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
        return subprocess.run(["git", "-C", tmp_path, *who, *args], check=True, capture_output=True, text=True).stdout

    code, figures = tmp_path / "cei_gym/__init__.py", tmp_path / "results/replay/replay.json"
    for path in (code, figures):
        path.parent.mkdir(parents=True)
        path.write_text("1")
    monkeypatch.setattr(cei_gym, "__file__", str(code))
    git("init")
    assert git_commit() is None  # not in it yet
    git("add", ".")
    git("commit", "-m", "all")
    head = git("rev-parse", "HEAD").strip()
    assert git_commit() == head
    figures.write_text("2")
    (tmp_path / "outputs.json").write_text("")
    assert git_commit() == head
    code.write_text("2")
    assert git_commit() == f"{head}-dirty"
