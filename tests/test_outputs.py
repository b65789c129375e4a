"""What commands write: results are never replaced unasked, pictures beside them are, by their like; nothing goes where it does not belong, and nothing
is left half done."""

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import killed
import numpy as np
import pytest
from PIL import Image

from cei_converters import calibrate, convert, pads, record, replay, report, view
from cei_converters.benchmark import command as benchmark
from cei_converters.benchmark.policy import PolicyBenchmarkConfig
from cei_converters.benchmark.real import RealBenchmarkConfig
from cei_converters.benchmark.replay import ReplayBenchmarkConfig
from cei_converters.cli import option_types
from cei_converters.cli.outputs import (
    ASKED_PICTURE,
    JOINT_MAP,
    JSON,
    PAGE,
    PICTURE,
    RECORDING,
    VIDEO,
    Kind,
    Output,
    Outputs,
)
from cei_converters.conversion.config import ConvertConfig
from cei_converters.dataset.place import HiddenFolder, check_place, tidy
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.inspection import command as inspecting
from cei_converters.report.command import ReportConfig
from cei_converters.view.command import ViewConfig
from cei_gym.errors import CEIError

SOURCE, ROBOT = "me/pick", killed.ROBOT


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("HOME", str(tmp_path))
    return folder


def tree(folder: Path) -> dict[str, bytes | str]:
    """Path to content, of all that is there."""
    found: dict[str, bytes | str] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        found[name] = str(path.readlink()) if path.is_symlink() else path.read_bytes() if path.is_file() else "folder"
    return found


# -- each option that names a file ---------------------------------------------------------------------------------------

Main = Callable[[list[str]], int]


def dataset(source: Path) -> list[str]:
    return [f"--dataset.repo_id={SOURCE}", f"--dataset.root={source}"]


def converting(source: Path) -> list[str]:
    quick = ["--target=UR5e-PandaGripper", "--init.starts=8", "--init.basins=1", "--episodes=0", "--allow_unreachable"]
    return [*dataset(source), *quick]


COMMANDS: dict[str, tuple[Main, Callable[[Path], list[str]], type]] = {
    "convert": (convert.main, lambda source: [*converting(source), "--dry_run"], ConvertConfig),
    "record": (
        record.main,
        lambda _: ["--env=CEI-PickCube-Panda-PandaGripper", "--episodes=1", "--repo_id=me/x", "--root=made"],
        record.RecordConfig,
    ),
    "replay": (replay.main, dataset, replay.ReplayConfig),
    "inspect": (inspecting.main, lambda source: [*dataset(source), f"--source={ROBOT}"], inspecting.InspectConfig),
    "calibrate": (
        calibrate.main,
        lambda source: [*dataset(source), "--camera=front", "--output=cameras.yaml"],
        calibrate.CalibrateConfig,
    ),
    "pads": (pads.main, lambda _: ["--end_effector=PandaGripper", "--output=pads.png"], pads.PadsConfig),
    "report": (report.main, lambda source: [*dataset(source), "--output=report.html"], ReportConfig),
    "view": (view.main, lambda source: [*dataset(source), "--sheet=view.png"], ViewConfig),
}
"""Name to entry point, options that it works with, and what has its options."""

FILES: dict[tuple[str, str], Kind] = {
    **{(name, "json"): JSON for name in COMMANDS},
    ("replay", "video"): VIDEO,
    ("inspect", "save_map"): JOINT_MAP,
    ("calibrate", "output"): JOINT_MAP,
    ("calibrate", "sheet"): PICTURE,
    ("pads", "output"): ASKED_PICTURE,
    ("report", "output"): PAGE,
    ("view", "rrd"): RECORDING,
    ("view", "sheet"): PICTURE,
}
NOT_WRITTEN = {
    *(
        "root",
        "new_root",
        "dataset.root",
        "source.root",
        "source.joint_map",
        "joint_map",
        "calibration",
        "clicks",
        "beside",
        "package_path",
        "replay",
    ),
}
"""Options with paths that are read, or are folders of datasets."""
LIKE = {
    "JSON file": b"{}\n",
    "YAML file": b"a: b\n",
    "PNG picture": b"\x89PNG\r\n\x1a\n....",
    "MP4 video": b"\0\0\0\x20ftypisom",
    "HTML page": b"<!doctype html>\n",
    "rerun recording": b"RRF2....",
}


def test_every_option_that_names_a_file_to_write_is_here() -> None:
    for name, (_, _, config) in COMMANDS.items():
        paths = {option for option, hint in option_types(config).items() if "Path" in str(hint)}
        assert paths - NOT_WRITTEN == {option for command, option in FILES if command == name}, name
    for config in (ReplayBenchmarkConfig, PolicyBenchmarkConfig, RealBenchmarkConfig):
        assert {option for option, hint in option_types(config).items() if "Path" in str(hint)} == {"results", "work"}


def given(name: str, option: str, value: object, source: Path) -> list[str]:
    args = [arg for arg in COMMANDS[name][1](source) if not arg.startswith(f"--{option}=")]
    return [*args, f"--{option}={value}"]


@pytest.mark.parametrize(("name", "option"), FILES)
def test_what_is_there_is_replaced_by_its_like_or_not_at_all(
    name: str, option: str, source: Path, here: Path, capsys: pytest.CaptureFixture
) -> None:
    kind, main = FILES[name, option], COMMANDS[name][0]
    suffix = kind.suffixes[0] if kind.suffixes else ".json"
    there = here / f"there{suffix}"

    def refused(message: str, *more: str, path: Path = there) -> None:
        before, of_the_source = tree(here), tree(source)
        assert main([*given(name, option, path, source), *more]) == 1
        error = capsys.readouterr().err
        assert message in error
        assert error.startswith(f"error: --{option}=") and error.count("\n") == 1
        assert (tree(here), tree(source)) == (before, of_the_source)

    overwrite = [] if kind.made_again else ["--overwrite"]
    if not kind.made_again:
        there.write_bytes(LIKE[kind.name])
        refused("already exists; choose another file, remove it first, or replace it with --overwrite.")
    if kind.begins:
        there.write_bytes(b"my: notes\n" * 10)
        refused(f"is there and is no {kind.name}, so it is not replaced", *overwrite)
    there.unlink(missing_ok=True)
    there.mkdir()
    refused("is a folder, which nothing replaces", *overwrite)
    there.rmdir()
    (here / f"far{suffix}").write_bytes(LIKE[kind.name])
    for to in (f"far{suffix}", "nowhere"):
        there.symlink_to(here / to)
        refused("is a link, which nothing replaces", *overwrite)
        there.unlink()
    os.mkfifo(there)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "read_bytes", lambda path: b"")  # of a pipe, which `tree` would wait for
        refused("is no plain file, which nothing replaces", *overwrite)
    there.unlink()
    refused("is no folder", path=here / f"far{suffix}" / f"x{suffix}")
    refused("too long", path=here / f"{'x' * 300}{suffix}")
    refused(f"is inside the dataset {source}", path=source / f"x{suffix}")
    refused(f"is inside the dataset {source}", path=source / "new" / f"x{suffix}")
    (here / "link").symlink_to(source)
    refused(f"is inside the dataset {source}", path=here / "link" / f"x{suffix}")
    if kind.suffixes:
        refused(f"should end in {kind.suffixes[0]}", path=here / "x.txt")
    there.write_bytes(LIKE[kind.name])
    there.chmod(0o444)
    if not os.access(there, os.W_OK):  # as it is for root
        refused("must not be written to", *overwrite)


def test_a_result_is_replaced_if_asked_for_and_only_when_it_is_whole(
    here: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    args = ["--end_effector=PandaGripper", "--output=new/a/pads.png", "--json=results/b/pads.json"]
    assert pads.main(args) == 0  # with the folders that it needs
    assert json.loads(Path("results/b/pads.json").read_text())["end_effector"] == "PandaGripper"
    first = tree(here)
    assert pads.main(args) == 1
    assert pads.main([*args, "--overwrite", "--points=64"]) == 0
    assert sum(json.loads(Path("results/b/pads.json").read_text())["pads"].values()) == 64
    assert first.keys() == tree(here).keys()
    second = tree(here)

    def broken(*_: object, **__: object) -> str:
        raise OSError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr(json, "dumps", broken)
        assert pads.main([*args, "--overwrite", "--points=32"]) == 1
    with monkeypatch.context() as patch:
        patch.setattr(Image.Image, "save", broken)
        assert pads.main([*args, "--overwrite"]) == 1
        assert pads.main(["--end_effector=PandaGripper", "--output=other/c/pads.png"]) == 1
    after = tree(here)
    assert after["results/b/pads.json"] == second["results/b/pads.json"]
    assert after.keys() == second.keys()


def test_a_picture_of_pads_is_drawn_again_in_its_place_if_asked_for(here: Path, capsys: pytest.CaptureFixture) -> None:
    args = ["--end_effector=PandaGripper", "--output=pads.png"]
    assert pads.main([*args, "--pose=home"]) == 0
    home = np.asarray(Image.open("pads.png"))
    assert pads.main([*args, "--pose=closed"]) == 1
    assert "--output=pads.png already exists" in capsys.readouterr().err
    assert (np.asarray(Image.open("pads.png")) == home).all()
    assert pads.main([*args, "--pose=closed", "--overwrite"]) == 0
    assert (np.asarray(Image.open("pads.png")) != home).any()
    assert list(tree(here)) == ["pads.png"]


def test_a_film_and_its_contact_sheet_are_replaced_together_or_not_at_all(
    source: Path, here: Path, capsys: pytest.CaptureFixture
) -> None:
    (here / "film.png").write_text("my notes")
    assert replay.main([*dataset(source), "--video=film.mp4"]) == 1
    assert "the contact sheet of --video=film.png is there and is no PNG picture" in capsys.readouterr().err
    default = Path("outputs/replay/pick.png")
    default.parent.mkdir(parents=True)
    default.write_text("my notes")
    assert replay.main(dataset(source)) == 1
    assert "the contact sheet of --video=outputs/replay/pick.png is there" in capsys.readouterr().err


def test_two_options_do_not_name_one_file(source: Path, here: Path, capsys: pytest.CaptureFixture) -> None:
    for args, message in (
        (
            (pads.main, ["--end_effector=PandaGripper", "--output=a.png", "--json=./a.png"]),
            "--json=a.png is the file of --output",
        ),
        ((replay.main, [*dataset(source), "--video=a.mp4", "--json=a.png"]), "a.png is the file of --json, too"),
        (
            (inspecting.main, [*dataset(source), f"--source={ROBOT}", "--save_map=a.yaml", "--json=x/../a.yaml"]),
            "the file of",
        ),
    ):
        main, options = args
        assert main(options) == 1
        assert message in capsys.readouterr().err
        assert tree(here) == {}


def test_no_map_is_no_success(here: Path, source: Path, capsys: pytest.CaptureFixture) -> None:
    state = source / "meta/info.json"
    info = json.loads(state.read_text())
    args = [*dataset(source), "--source=UR5e-Inspire", "--save_map=map.yaml", "--json=found.json"]
    try:  # columns that are no joints of it
        state.write_text(state.read_text().replace(".pos_rad", ".pos_m"))
        assert inspecting.main(args) == 1
    finally:
        state.write_text(json.dumps(info))
    error = capsys.readouterr().err
    assert error.startswith(
        "error: no joint map could be proposed, so map.yaml is not made: no 6 neighbouring columns are within"
    )
    assert error.endswith("is it the right robot?\n") and error.count("\n") == 1
    assert list(tree(here)) == ["found.json"]


def test_a_file_that_came_meanwhile_is_kept(here: Path) -> None:
    output = Outputs().file("--json", "a.json", JSON)
    assert output is not None
    with pytest.raises(CEIError, match=r"a\.json came into being meanwhile"), output.whole() as partial:
        partial.write_text("{}")
        Path("a.json").write_text("another's")
    assert tree(here) == {"a.json": b"another's"}


def test_what_a_killed_process_left_of_a_file_goes_and_a_living_ones_stays(here: Path) -> None:
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    host = socket.gethostname()
    for pid in (child.pid, dead.pid):
        (here / f".a.png.{host}.{pid}.partial").touch()
    (here / f".a.png.elsewhere-{host}.{dead.pid}.partial").touch()
    with Output(here / "a.png", replaces=True).whole() as partial:
        partial.touch()
    child.communicate(b"\n")
    kept = [f".a.png.elsewhere-{host}.{dead.pid}.partial", f".a.png.{host}.{child.pid}.partial", "a.png"]
    assert sorted(tree(here)) == sorted(kept)


# -- folders of datasets -------------------------------------------------------------------------------------------------


def test_where_no_dataset_can_be(source: Path, here: Path, capsys: pytest.CaptureFixture) -> None:
    """Said before any work, of `cei-convert`, `cei-record` and LeRobot's cache alike."""
    (here / "file").write_text("x")
    (here / "loop").symlink_to(here / "loop")
    (here / "dangling").symlink_to(here / "nowhere")
    (here / "linked").symlink_to(source)
    (here / ".mine.partial").mkdir()
    (here / ".mine.partial" / "notes").write_text("x")
    (here / "zarr").mkdir()
    (here / "zarr" / ".zgroup").write_text("{}")
    for root, message in (
        (source, "already exists"),
        (here, "already exists"),
        (here / "file", "already exists"),
        (here / "linked", "already exists"),
        (here / "dangling", f"is a link to {here / 'nowhere'}, which is not there"),
        (here / "loop", "loop"),
        (source / "out", f"is inside the dataset {source}"),
        (source / "deep" / "er" / "out", f"is inside the dataset {source}"),
        (source / "data", "already exists"),
        (here / "linked" / "out", f"is inside the dataset {source}"),
        (here / "zarr" / "data" / "out", f"is inside the dataset {here / 'zarr'}"),
        (here / "file" / "out", f"{here / 'file'} is no folder"),
        (here / ("x" * 250), "File name too long"),
        (here / "new" / ("x" * 300) / "out", "File name too long"),
        (here / "mine", ".mine.partial is in the way"),
        (Path("/proc/out"), "cannot be made in /proc"),
    ):
        before, of_the_source = tree(here), tree(source)
        for main, args in (
            (convert.main, [*converting(source), "--new_repo_id=me/out", f"--new_root={root}"]),
            (
                record.main,
                ["--env=CEI-PickCube-Panda-PandaGripper", "--repo_id=me/x", "--episodes=1", f"--root={root}"],
            ),
        ):
            start = time.monotonic()
            assert main(args) == 1, root
            error = capsys.readouterr().err
            assert message in error, root
            assert error.startswith("error: ") and error.count("\n") == 1
            assert (tree(here), tree(source)) == (before, of_the_source)
            assert main is not convert.main or time.monotonic() - start < 60


def test_results_do_not_go_into_the_dataset_that_is_made(
    source: Path, here: Path, capsys: pytest.CaptureFixture
) -> None:
    for json_path in ("out/result.json", "./out/meta/x.json", ".out.partial/x.json"):
        args = [*converting(source), "--new_repo_id=me/out", "--new_root=out", f"--json={json_path}"]
        assert convert.main(args) == 1
        assert f"--json={Path(json_path)} is inside the dataset that is to be made" in capsys.readouterr().err
        args = ["--env=CEI-PickCube-Panda-PandaGripper", "--repo_id=me/x", "--root=out", f"--json={json_path}"]
        assert record.main(args) == 1
        assert f"--json={Path(json_path)} is inside the dataset that is to be made" in capsys.readouterr().err
    assert tree(here) == {}


def test_a_disk_that_is_full_or_read_only_is_told_before_the_work(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", disk], capture_output=True).returncode:
        pytest.skip("mounting a small disk takes more rights")
    try:
        with pytest.raises(CEIError, match="the disk is full"):
            check_place(disk / "out")
        subprocess.run(["mount", "-o", "remount,size=20m,ro", disk], check=True)
        for check in (check_place, lambda path: Outputs().file("--json", path, JSON)):
            with pytest.raises(CEIError, match="Read-only file system"):
                check(disk / "out")
    finally:
        subprocess.run(["umount", disk], check=True)


LEAVER = """
import os, signal, sys
from pathlib import Path
from cei_converters.dataset.place import HiddenFolder
hidden = HiddenFolder(Path(sys.argv[1]), "cei-record")
hidden.acquire()
(hidden.path / "dataset").mkdir()
(hidden.path / "dataset" / "half").write_text("x")
print("made", flush=True)
input()
"""


def recorder(root: Path) -> subprocess.Popen:
    """A process that has begun to make a dataset."""
    process = subprocess.Popen(
        [sys.executable, "-c", LEAVER, root],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=dict(os.environ),
    )
    assert process.stdout is not None and process.stdout.readline() == "made\n"
    return process


@pytest.mark.parametrize("name", ["one", "other"])
def test_what_a_killed_recording_left_goes_with_the_next_to_the_same_folder(name: str, tmp_path: Path) -> None:
    """To the same dataset or another beside it. What belongs to the living stays, and what nobody here made."""
    process, living = recorder(tmp_path / "one"), recorder(tmp_path / "living")
    process.kill()
    process.communicate()
    mine, far = tmp_path / ".mine.partial", tmp_path / ".far.partial"
    for folder in (mine, far):
        folder.mkdir()
        (folder / "lock").touch()
    (far / "owner.json").write_text(json.dumps({"host": "elsewhere", "boot": "another"}))
    assert (tmp_path / ".one.partial" / "dataset" / "half").exists()
    episode = killed.demonstration()
    with DatasetWriter("me/x", tmp_path / name) as writer:
        writer.add(episode)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {name, ".living.partial", ".mine.partial", ".far.partial"}
    with (
        pytest.raises(CEIError, match=r"another cei-record is making .*/living; choose"),
        DatasetWriter("me/x", tmp_path / "living"),
    ):
        pass
    with pytest.raises(CEIError, match="/far is, or was, being made on elsewhere; if that has ended, remove"):
        HiddenFolder(tmp_path / "far", "cei-record").acquire()
    living.communicate("\n")


@pytest.mark.parametrize("name", ["plan.json", "half"])
def test_what_is_killed_while_it_removes_its_folder_is_finished_by_the_next(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever of it is gone by then: of a recording that is given up, and beside a dataset that is published."""
    removed: list[str] = []

    class Killed(BaseException):
        pass

    def counted(remove: Callable) -> Callable:
        def call(path: object, *args: object, **kwargs: object) -> object:
            if len(removed) == kept:
                raise Killed
            removed.append(str(path))
            return remove(path, *args, **kwargs)

        return call

    for kept in range(6):
        root = tmp_path / f"x{kept}"
        hidden = HiddenFolder(root, "cei-record")
        hidden.acquire()
        (hidden.path / "dataset").mkdir()
        (hidden.path / "dataset" / "half").touch()
        (hidden.path / name).touch()
        removed.clear()
        with monkeypatch.context() as patch, contextlib.suppress(Killed):
            for owner, function in ((os, "unlink"), (os, "rmdir")):
                patch.setattr(owner, function, counted(getattr(owner, function)))
            hidden.release(keep=False)
        hidden.release(keep=True)  # as the system does for the dead
        if kept % 2:
            root.mkdir()
            tidy(root)
            root.rmdir()
        else:
            again = HiddenFolder(root, "cei-record")
            again.acquire(resume=True)
            again.release(keep=False)
        assert list(tmp_path.iterdir()) == [], removed


def test_recordings_and_conversions_do_not_take_each_others_folders(tmp_path: Path) -> None:
    folder = tmp_path / ".x.partial"
    folder.mkdir()
    (folder / "plan.json").write_text("{}")
    with pytest.raises(CEIError, match="was begun and not finished"), DatasetWriter("me/x", tmp_path / "x"):
        pass
    with DatasetWriter("me/x", tmp_path / "y") as writer:
        writer.add(killed.demonstration())
    assert {path.name for path in tmp_path.iterdir()} == {".x.partial", "y"}


# -- the benchmark's folders ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "file"),
    [("replay", "replay.md"), ("replay", "heat_map.png"), ("policy", "policy.csv"), ("real", "real.md")],
)
def test_a_folder_that_is_somebody_elses_gets_no_results(
    name: str, file: str, here: Path, capsys: pytest.CaptureFixture
) -> None:
    (here / "docs").mkdir()
    (here / "docs" / file).write_text("mine")
    before = tree(here)
    assert benchmark.main([name, "--results=docs", "--redraw"]) == 1
    assert f"docs/{file} is there, but no finished cell" in capsys.readouterr().err
    for option in ("results", "work"):
        assert benchmark.main([name, f"--{option}=docs/{file}", "--redraw"]) == 1
        assert f"--{option}=docs/{file} cannot be made: {here}/docs/{file} is no folder" in capsys.readouterr().err
    assert tree(here) == before
    shutil.rmtree(here / "docs")
