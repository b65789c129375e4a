"""Commands that are told to end: at whatever moment, with one word, the exit code that shells expect, and nothing left behind."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import killed
import numpy as np
import pytest

from cei_converters import convert, signals
from cei_converters.cli import run
from cei_converters.dataset.place import temporary_folder
from cei_converters.dataset.writer import DatasetWriter
from cei_gym.rendering import look_at

ROOT = Path(__file__).parents[1]
SCRIPTS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
SAID = {signal.SIGINT: (130, "interrupted\n"), signal.SIGTERM: (143, "terminated\n"), signal.SIGHUP: (129, "hung up\n")}
MOMENTS_S = ((0.0, 0.0), (0.0, 1.0), (1.0, 3.0))
"""Of each command: between which times after it heeds signals one comes."""
RESTORED = ("README.md", "meta/cei.json", "meta/cei_episodes.jsonl")
"""What `cei-restore` adds; a signal that comes while it moves them waits until they are all there."""


def command(name: str) -> list[str]:
    """A command as installers write it."""
    module, _, function = SCRIPTS[name].partition(":")
    return [sys.executable, "-c", f"import sys\nfrom {module} import {function}\nsys.exit({function}())"]


def heeds(process: subprocess.Popen) -> bool:
    """Whether a process has taken charge of its signals; before that they do to it what they do to any Python."""
    with contextlib.suppress(OSError, StopIteration):
        lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        caught = next(line for line in lines if line.startswith("SigCgt"))
        return bool(int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1)
    return True


def pictured(source: Path) -> Path:
    """A dataset with pictures beside the source, of noise, in which a camera is looked for until it is given up."""
    root = source.with_name("pictured")
    if source.exists() and not root.exists():
        random = np.random.default_rng(0)
        shown = killed.demonstration(4, random)
        camera = look_at("front", (1.5, 0.5, 1.0), (0.3, 0.0, 0.3), 320, 240, 45.0)
        size = (len(shown), camera.height, camera.width)
        noise = random.integers(0, 256, (*size, 3), dtype=np.uint8)
        scene = replace(shown.scene, cameras=(camera,))
        with DatasetWriter("me/pick", root) as writer:
            writer.add(replace(shown, scene=scene, depth_m={"front": np.ones(size, np.float32)}, rgb={"front": noise}))
    return root


def options(name: str, source: Path) -> list[str]:
    dataset = ["--dataset.repo_id=me/pick", f"--dataset.root={source}"]
    return {
        "cei-record": [
            "--env=CEI-PickCube-Panda-PandaGripper",
            "--episodes=2",
            "--repo_id=me/x",
            "--root=a/x",
            "--json=r.json",
        ],
        "cei-convert": [arg for arg in killed.arguments(source, Path("a/x"), "--workers=4") if "--init" not in arg],
        "cei-inspect": [*dataset, f"--source={killed.ROBOT}", "--json=r.json"],
        "cei-replay": [*dataset, "--env=CEI-PickCube-Panda-PandaGripper", "--json=r.json"],
        "cei-calibrate": [
            "--dataset.repo_id=me/pick",
            f"--dataset.root={pictured(source)}",
            "--camera=front",
            "--output=a/c.yaml",
            "--sheet=s.png",
        ],
        "cei-pads": ["--end_effector=Inspire", "--output=a/p.png", "--points=20000"],
        "cei-robot": ["new", "package://robosuite/models/assets/grippers/rethink_gripper.xml", "--output=a"],
        "cei-view": [*dataset, "--rrd=a/v.rrd", "--sheet=v.png"],
        "cei-report": [*dataset, "--output=a/r.html", "--films", "--json=r.json"],
        "cei-restore": ["--dataset.repo_id=me/x", "--dataset.root=../edited", f"--original={source}", "--json=r.json"],
        "cei-benchmark": [
            "replay",
            "--episodes=1",
            "--tasks=PickCube",
            "--targets=IIWA-Inspire",
            "--results=r",
            "--work=w",
        ],
    }[name]


def edit(source: Path, root: Path) -> None:
    """The dataset as LeRobot's tools would leave it, who know nothing of these files."""
    shutil.rmtree(root, ignore_errors=True)
    shutil.copytree(source, root, ignore=shutil.ignore_patterns("README.md", "cei*"))


def test_every_command_is_here() -> None:
    assert set(SCRIPTS) == {name for name in SCRIPTS if options(name, Path("source"))}


@pytest.mark.skipif(sys.platform != "linux", reason="it looks into /proc to see when a process heeds signals")
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_signal_ends_a_command_at_any_moment(name: str, source: Path, tmp_path: Path) -> None:
    """In its first seconds, from its first line on: to it alone or, as from a terminal, to all its processes; again while it tidies up."""
    moments = random.Random(name)
    for i, between in enumerate(MOMENTS_S):
        number = moments.choice(list(SAID))
        here, edited = tmp_path / str(i), tmp_path / "edited"
        here.mkdir()
        edit(source, edited)
        before = sorted(edited.rglob("*"))
        process = subprocess.Popen(
            [*command(name), *options(name, source)],
            cwd=here,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        while not heeds(process):
            time.sleep(0.001)
        time.sleep(moments.uniform(*between))
        send: Callable[[int, int], None] = moments.choice([os.kill, os.killpg])
        with contextlib.suppress(ProcessLookupError):
            send(process.pid, number)
            time.sleep(moments.uniform(0, 0.02))
            os.kill(process.pid, number)
        _, error = process.communicate(timeout=120)
        if process.returncode == 0:  # it was faster
            continue
        code, said = SAID[number]
        kept = [line for line in error.splitlines() if line.startswith("What is done is kept in ")]
        assert error.removeprefix("".join(f"{line}\n" for line in kept)) == said
        assert process.returncode == code
        after = sorted(edited.rglob("*"))
        restored = sorted([*before, *(edited / path for path in RESTORED)])
        assert after == before or (name == "cei-restore" and after == restored)  # all or nothing
        left = [] if kept else [path.relative_to(here) for path in here.rglob("*")]
        assert not [path for path in left if path.parts[0] != "w"]  # the benchmark's own work folder stays


LIBRARY = """
import sys, threading, time
from pathlib import Path
from cei_converters import signals, start
from cei_converters.dataset.place import temporary_folder
signals.own()
from dataclasses import dataclass
from cei_converters.cli import run

@dataclass
class Config:
    "Nothing."

def swallows() -> None:
    for _ in range(1000):
        try:
            print("ready", flush=True)
            time.sleep(10)
        except BaseException:
            pass

def translates() -> None:
    try:
        print("ready", flush=True)
        time.sleep(10)
    except BaseException as error:
        raise OSError("the disk is on fire") from error

def crashes() -> None:
    try:
        print("ready", flush=True)
        time.sleep(10)
    finally:
        raise RuntimeError

def waits() -> None:
    thread = threading.Thread(target=lambda: time.sleep(60))
    thread.start()
    print("ready", flush=True)
    thread.join()

def finishes() -> None:
    try:
        print("ready", flush=True)
        time.sleep(10)
    except BaseException:
        pass

def held() -> None:
    with signals.held():
        print("ready", flush=True)
        time.sleep(0.5)
        Path("made").mkdir()
        signals.begin(lambda: Path("made").exists() and Path("made").rmdir())
    time.sleep(10)

def func(_: Config) -> None:
    with temporary_folder(Path()) as folder:
        (folder / "file").write_text("x")
        globals()[sys.argv.pop()]()

name = sys.argv.pop()
sys.argv.append(name)
code = run(Config, func, [], prog="x", example="")
signals.finished(code)
import os
sys.stdout.flush(); sys.stderr.flush()
os._exit(code)
"""


@pytest.mark.parametrize("what", ["swallows", "translates", "crashes", "waits", "finishes", "held"])
@pytest.mark.parametrize("number", SAID)
def test_whatever_a_library_makes_of_a_signal_it_ends_the_command(what: str, number: int, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", LIBRARY, what], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    start = time.monotonic()
    os.kill(process.pid, number)
    _, error = process.communicate(timeout=60)
    code, said = SAID[number]
    assert (process.returncode, error) == (code, said)
    assert time.monotonic() - start < signals.PATIENCE_S + 5
    assert list(tmp_path.iterdir()) == []


LAST = """
import os, sys
from cei_converters import signals

class Last:
    "Goes as modules do, when Python has given signals back."

    def __del__(self) -> None:
        os.kill(os.getpid(), int(sys.argv[1]))
        os.write(1, b"whole")

last = Last()
signals.own()
signals.finished(3)
sys.exit(3)
"""


@pytest.mark.parametrize("number", SAID)
def test_a_signal_that_comes_as_python_ends_changes_nothing(number: int) -> None:
    process = subprocess.run([sys.executable, "-c", LAST.replace("sys.argv[1]", str(int(number)))], capture_output=True)
    assert (process.returncode, process.stdout, process.stderr) == (3, b"whole", b"")


def test_what_is_to_ignore_a_signal_ignores_it(tmp_path: Path) -> None:
    """As `nohup` has it, and shells for what runs in the background."""
    script = 'trap "" HUP INT; exec "$@"'
    args = [*command("cei-pads"), "--end_effector=PandaGripper", "--output=p.png"]
    process = subprocess.Popen(["bash", "-c", script, "-", *args], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    while not heeds(process):
        time.sleep(0.001)
    for number in (signal.SIGHUP, signal.SIGINT):
        os.kill(process.pid, number)
    assert process.communicate(timeout=120)[1] == ""
    assert process.returncode == 0
    assert (tmp_path / "p.png").exists()


def test_a_process_of_somebody_else_keeps_its_signals(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Commands that are called as functions raise, return, and leave handlers as they were."""
    from dataclasses import dataclass

    @dataclass
    class Config:
        """Nothing."""

    before = [signal.getsignal(number) for number in SAID]
    for number, (code, said) in SAID.items():

        def interrupted(_: object, number: int = number) -> None:
            with temporary_folder(tmp_path):
                os.kill(os.getpid(), number)
                time.sleep(10)

        assert run(Config, interrupted, [], prog="x", example="") == code
        assert capsys.readouterr().err == said
        assert list(tmp_path.iterdir()) == []
    assert run(Config, lambda _: None, [], prog="x", example="") == 0
    assert [signal.getsignal(number) for number in SAID] == before


def test_a_reader_that_leaves_is_no_error(source: Path) -> None:
    args = [*command("cei-inspect"), "--dataset.repo_id=me/pick", f"--dataset.root={source}"]
    process = subprocess.Popen(args, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait(120) != 0


def test_a_conversion_that_is_terminated_is_gone_on_with(source: Path, tmp_path: Path) -> None:
    root = tmp_path / "x"
    args = [*command("cei-convert"), *killed.arguments(source, root)]
    shards = root.with_name(".x.partial") / "shards"
    process = subprocess.Popen(args, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not list(shards.glob("0*")):
        time.sleep(0.002)
    process.terminate()
    _, error = process.communicate(timeout=60)
    if process.returncode == 0:
        pytest.skip("it was faster")
    assert process.returncode == 143
    assert error == f"What is done is kept in {shards.parent}: the same command with --resume goes on.\nterminated\n"
    assert convert.main([*killed.arguments(source, root), "--resume"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["x"]


def test_a_signal_that_strikes_what_a_compiler_calls_back_is_heard_later() -> None:
    """What is raised in a callback of ctypes is printed, and lost."""
    script = (
        "import ctypes, os, signal, sys, time\n"
        "from cei_converters import signals\n"
        "signals.own()\n"
        "body = 'def back():\\n    import os, signal, time\\n    os.kill(os.getpid(), signal.SIGTERM)\\n    time.sleep(0.05)\\n'\n"
        "found = {}\n"
        "exec(compile(body, os.path.join('somewhere', 'llvmlite', 'binding', 'executionengine.py'), 'exec'), found)\n"
        "ctypes.CFUNCTYPE(None)(found['back'])()\n"
        "for _ in range(500):\n"
        "    time.sleep(0.01)\n"
        "print('deaf')\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr, done.stdout) == (128 + signal.SIGTERM, "terminated\n", "")
