"""Conversions that are interrupted, and go on."""

import contextlib
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import killed
import numpy as np
import pytest
from conversions import same

from cei_converters import convert
from cei_converters.dataset.provenance import fingerprint

KILLS = 8
"""One of each stage."""


@pytest.fixture(scope="module")
def whole(source: Path) -> Path:
    """What an uninterrupted run makes of it."""
    root = source.with_name("whole")
    assert convert.main(killed.arguments(source, root)) == 0
    return root


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[list[str]], Any]]:
    """Starts `cei-convert` in a process that has imported everything; it has a `log`."""
    log = tmp_path_factory.mktemp("killed") / "log"
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["killed"])

    def start(args: list[str]) -> Any:
        process: Any = context.Process(target=killed.run, args=(args, log))
        process.log = log
        process.start()
        return process

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CEI_WARM", "1")
        folders = [str(Path(killed.__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        patch.setenv("PYTHONPATH", os.pathsep.join(folders))  # the server's own, for its preloads
        start(["--help"]).join()
        yield start


def siblings(root: Path) -> list[str]:
    return sorted(path.name for path in root.parent.iterdir() if root.name in path.name)


def test_killed_at_any_moment_and_resumed_it_makes_the_same_dataset(
    source: Path, whole: Path, start: Callable, tmp_path: Path
) -> None:
    """At random moments after it begins, plans, finishes each shard, and begins to put them together: however busy the machine is,
    there are kills of every stage."""
    before, random, stages = fingerprint(source), np.random.default_rng(0), []
    begun = [".", "plan.json", *(f"shards/{shard:06d}" for shard in range(killed.EPISODES)), "dataset"]
    for i in range(KILLS):
        root = tmp_path / f"out{i}"
        folder = root.with_name(f".{root.name}.partial")
        process = start(killed.arguments(source, root))
        while process.is_alive() and not (folder / begun[i % len(begun)]).exists():
            time.sleep(0.001)
        process.join(random.exponential(0.05))
        process.kill()
        process.join()
        if not root.exists():  # else it was finished before
            stages.append(len(list(folder.glob("shards/0*"))) if (folder / "plan.json").exists() else -1)
        process = start(killed.arguments(source, root, "--resume"))
        process.join()
        assert process.exitcode == 0, process.log.read_text()
        assert siblings(root) == [root.name]
        same(root, whole)
        shutil.rmtree(root)
    assert len(set(stages)) > 2, f"kills should fall before, between and after shards, not at {stages}"
    assert fingerprint(source) == before


def test_workers_make_the_same_dataset(source: Path, whole: Path, tmp_path: Path) -> None:
    assert convert.main(killed.arguments(source, tmp_path / "out", "--workers=4", "--shard_episodes=2")) == 0
    same(tmp_path / "out", whole)


@pytest.mark.parametrize("victim", ["worker", "parent"])
def test_where_one_of_many_processes_is_killed_what_is_done_is_kept(
    source: Path, whole: Path, tmp_path: Path, victim: str
) -> None:
    root = tmp_path / "out"
    args = killed.arguments(source, root, "--workers=4")
    command = [sys.executable, "-m", "cei_converters.convert", *args]
    command = [
        "bash",
        "-c",
        'trap "" INT; exec "$@"',
        "-",
        *command,
    ]  # as shells have it for what runs in the background
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    shards = root.with_name(f".{root.name}.partial") / "shards"
    while process.poll() is None and not list(shards.glob("0*")):
        time.sleep(0.01)
    while process.poll() is None:
        workers = [int(path.name.rpartition("-")[2]) for path in shards.glob(".*-*")]
        for pid in workers if victim == "worker" else [process.pid]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.01)
    assert process.stderr is not None
    if victim == "worker":
        assert process.returncode == 1
        kept, error = process.stderr.read().splitlines()
        assert kept == f"What is done is kept in {shards.parent}: the same command with --resume goes on."
        assert error.startswith("error: a worker was killed, maybe for want of memory; go on with --resume")
    assert not root.exists()
    assert (
        convert.main(killed.arguments(source, root, "--resume")) == 0
    )  # while workers of a killed parent may still be there
    same(root, whole)
    assert siblings(root) == ["out"]
    left = [1]
    while left:  # no process stays behind
        time.sleep(0.1)
        lines = subprocess.run(
            ["ps", "-eo", "pid,args"], capture_output=True, text=True, check=True
        ).stdout.splitlines()
        left = [line for line in lines if str(root) in line]


@pytest.mark.skipif("CEI_RAY" not in os.environ, reason="minutes on busy cores, as Ray's workers are niced: make ray")
def test_ray_makes_the_same_dataset(source: Path, whole: Path, tmp_path: Path) -> None:
    args = killed.arguments(source, tmp_path / "out", "--executor=ray", "--shard_episodes=3")
    args.remove("--workers=1")
    command = [sys.executable, "-m", "cei_converters.convert", *args]
    env = os.environ | {"RAY_AUTH_MODE": "disabled"}
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=env, timeout=900)
    same(tmp_path / "out", whole)


SBATCH = """#!/bin/sh
for file; do :; done
n=$(ls "$QUEUE" | wc -l)
cp "$file" "$QUEUE/$n"
echo "$@" >"$QUEUE.options.$n"
echo Submitted batch job $n
"""
SRUN = """#!/bin/sh
while [ "${1#-}" != "$1" ]; do [ "$1" = -n ] && shift; shift; done
exec "$@"
"""


def test_slurm_makes_the_same_dataset(
    source: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """With commands that stand for Slurm's: jobs wait in a folder, and run when `sbatch` has long returned."""
    queue, commands, root = tmp_path / "queue", tmp_path / "commands", tmp_path / "out"
    args = [*killed.arguments(source, root, "--shard_episodes=3"), "--executor=slurm"]
    refused(args, capsys, "--executor=slurm needs --slurm.partition.")
    args += ["--slurm.partition=cpu", "--slurm.mem_gb=3"]
    refused(args, capsys, "there is no sbatch here; run this where jobs are submitted.")
    queue.mkdir()
    commands.mkdir()
    for name, text in (("sbatch", SBATCH), ("srun", SRUN), ("scontrol", "#!/bin/sh\necho here\n")):
        (commands / name).write_text(text)
        (commands / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{commands}:{os.environ['PATH']}")
    monkeypatch.setenv("QUEUE", str(queue))
    assert convert.main(args) == 0
    assert f"Submitted 2 shards to Slurm; job 2 then makes {root}." in capsys.readouterr().out
    assert not root.exists()
    jobs = [path.read_text() for path in sorted(queue.iterdir())]
    arrays = [re.findall(r"#SBATCH --array=(\S+)", job) for job in jobs]
    assert arrays[0] == ["0-1%1"]
    assert "--dependency=afterany:0" in (tmp_path / "queue.options.2").read_text()
    for number, job in enumerate(jobs):
        assert "#SBATCH --partition=cpu" in job
        for task in range(2 if number == 0 else 1):
            env = os.environ | {"SLURM_ARRAY_TASK_ID": str(task), "SLURM_NODELIST": "here"}
            ran = subprocess.run(["bash", str(queue / str(number))], capture_output=True, text=True, env=env)
            assert ran.returncode == 0, ran.stderr
    same(root, whole)
    assert siblings(root) == ["out", "out.slurm"]


def refused(args: list[str], capsys: pytest.CaptureFixture, message: str) -> None:
    capsys.readouterr()
    assert convert.main(args) in (1, 2)
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert printed.count("\n") == 1
    assert message in printed


def test_what_was_begun_is_neither_mixed_up_nor_lost(
    source: Path, whole: Path, start: Callable, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    mine = tmp_path / "source"
    shutil.copytree(source, mine)
    root = tmp_path / "out"
    args = killed.arguments(mine, root)
    shards = tmp_path / ".out.partial/shards"
    process = start(args)
    while not list(shards.glob("0*")):
        time.sleep(0.002)
    os.kill(process.pid, signal.SIGSTOP)
    refused(args, capsys, f"another cei-convert is making {root}")
    refused([*args, "--resume"], capsys, f"another cei-convert is making {root}")
    process.kill()
    process.join()
    refused(args, capsys, f"a conversion to {root} was begun and not finished; go on with --resume, or remove")
    refused([*args, "--resume", "--clouds.points=512"], capsys, "--clouds.points was 1024, now it is 512; give what")
    data = next(mine.glob("data/*/*.parquet"))
    before = data.read_bytes()
    data.write_bytes(before + b" ")
    refused([*args, "--resume"], capsys, "me/pick has changed since the conversion began")
    data.write_bytes(before)
    frames = next(shards.glob("0*")) / "frames.arrow"
    frames.write_bytes(frames.read_bytes()[:-1])  # made again
    capsys.readouterr()
    assert convert.main(killed.arguments(mine, root, "--resume", "--shard_episodes=3")) == 0
    assert "Shards stay as they were begun: --shard_episodes=1." in capsys.readouterr().out
    same(root, whole)
    shards.mkdir(parents=True)  # as if killed as soon as it was finished
    (shards.parent / "plan.json").touch()
    assert convert.main([*args, "--resume"]) == 0
    assert f"{root} is finished; nothing is left to do." in capsys.readouterr().out
    assert siblings(root) == [root.name]
    refused(args, capsys, f"{root} already exists")
    other = ["--target=UR5e-Inspire" if arg.startswith("--target=") else arg for arg in args]
    refused([*other, "--resume"], capsys, f"{root} already exists and is no dataset of UR5e-Inspire")


def test_what_is_wrong_in_a_workers_episode_is_told(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    args = [arg for arg in killed.arguments(source, tmp_path / "out", "--workers=4") if arg != "--allow_unreachable"]
    refused([*args, "--transfer.unreachable_mm=0.1"], capsys, "UR5e-PandaGripper does not follow the source in episode")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_told_and_room_is_all_it_needs(
    source: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=700k", "none", disk], capture_output=True).returncode:
        pytest.skip("mounting a small disk takes more rights")
    try:
        args = killed.arguments(source, disk / "out")
        assert convert.main(args) == 1
        kept, error = capsys.readouterr().err.splitlines()
        assert kept.startswith("What is done is kept in ")
        assert error.startswith("error: ")
        assert "No space left on device" in error
        assert not (disk / "out").exists()
        subprocess.run(["mount", "-o", "remount,size=20m", disk], check=True)
        assert convert.main([*args, "--resume"]) == 0
        same(disk / "out", whole)
    finally:
        subprocess.run(["umount", disk], check=True)
