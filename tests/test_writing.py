"""What LeRobot writes is written by a process beside the conversion, which ends with it, whoever calls it and however it ends."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from cei_converters.conversion.writing import Writing
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.sources.formats import open_source
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import load_embodiment

ROBOT, PATIENCE_S = "Panda-PandaGripper", 60


def processes() -> set[psutil.Process]:
    """Those of this one that live. What they run is no mark of them: the kernel tells it only a while after they begin."""
    return {each for each in psutil.Process().children() if each.status() != psutil.STATUS_ZOMBIE}


def test_a_killed_one_is_told_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "lerobot.datasets", raising=False)
    others = processes()
    with Writing() as writing:
        writing.begin(tmp_path)
        (process,) = processes() - others
        process.kill()
        with pytest.raises(OSError, match=r"the process that writes the dataset was killed.*go on with --resume"):
            writing.result()
    assert process not in processes()


def test_none_is_started_where_lerobot_is_imported() -> None:
    import lerobot.datasets  # noqa: F401

    others = processes()
    with Writing():
        assert not processes() - others


def test_it_ends_with_a_parent_that_is_killed() -> None:
    script = (
        "import os, psutil; from cei_converters.conversion.writing import Writing; Writing().__enter__(); "
        "print(psutil.Process().children()[0].pid, flush=True); os.kill(os.getpid(), 9)"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        left = int(parent.stdout.readline())
    deadline = time.monotonic() + PATIENCE_S
    while psutil.pid_exists(left) and psutil.Process(left).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_a_script_without_a_guard_converts(tmp_path: Path) -> None:
    """As people write them: nothing runs it a second time."""
    body = load_embodiment(ROBOT)
    path = body.home + 0.05 * np.sin(np.linspace(0, 2, 8))[:, None] * (np.arange(len(body.home)) < body.n_arm)
    scene = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]))
    with DatasetWriter("me/pick", tmp_path / "pick") as writer:
        writer.add(Demonstration(ROBOT, 20.0, path, path, scene, task="pick"))
    script = tmp_path / "mine.py"
    script.write_text(
        "from cei_converters.convert import main\n"
        f"code = main(['--dataset.repo_id=me/pick', '--dataset.root={tmp_path / 'pick'}', '--target=UR5e-PandaGripper',\n"
        f"    '--new_repo_id=me/new', '--new_root={tmp_path / 'new'}', '--init.starts=8', '--allow_unreachable'])\n"
        "print('once', code)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout.splitlines()[-1] == "once 0", done.stderr
    assert done.stdout.count("once") == 1
    (moved,) = open_source("me/new", tmp_path / "new")
    assert moved.embodiment == "UR5e-PandaGripper" and len(moved) >= len(path)
