"""LeRobot's scripts in processes that start ready: what `lerobot-train` imports takes it ten seconds each time.

`script` runs one in a fork of a process that has imported all of them, with the plugins that they find, and done nothing else; as from a
shell, it has its own arguments, folder and output, and ends with its exit code. `test_lerobot_scripts` starts some from a shell, too.
"""

import atexit
import functools
import importlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

SCRIPTS = {
    f"lerobot-{name}": f"lerobot.scripts.lerobot_{name.replace('-', '_')}"
    for name in ("train", "eval", "edit-dataset", "rollout")
}
"""Name to module, whose `main` it calls."""


EXAMPLES = Path(__file__).parents[1] / "examples"
"""Where the simulated robot is, which `lerobot-rollout` is told to import."""


def script(name: str, *options: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """What became of a script: its exit code, and all that it printed."""
    server = _server()
    assert server.stdin is not None and server.stdout is not None
    with tempfile.NamedTemporaryFile("w+") as printed:
        job = {"name": name, "options": options, "cwd": str(cwd), "output": printed.name}
        server.stdin.write(json.dumps(job) + "\n")
        server.stdin.flush()
        code = int(server.stdout.readline())
        printed.seek(0)
        return subprocess.CompletedProcess([name, *options], code, printed.read())


@functools.cache
def _server() -> subprocess.Popen[str]:
    path = os.pathsep.join([str(EXAMPLES), *filter(None, [os.environ.get("PYTHONPATH")])])
    server = subprocess.Popen(
        [sys.executable, __file__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1", "HF_HUB_OFFLINE": "1", "PYTHONPATH": path},
    )
    atexit.register(server.kill)
    return server


def _child(job: dict) -> None:
    output = os.open(job["output"], os.O_WRONLY | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.chdir(job["cwd"])
    sys.argv = [job["name"], *job["options"]]
    importlib.import_module(SCRIPTS[job["name"]]).main()


def _serve() -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever an import prints is no answer
    from lerobot.utils.import_utils import register_third_party_plugins

    for module in SCRIPTS.values():
        importlib.import_module(module)
    register_third_party_plugins()  # as each of them does
    for line in sys.stdin:
        if (pid := os.fork()) == 0:
            answers.close()
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            _child(json.loads(line))
            sys.stdout.flush()
            sys.exit(0)
        _, status = os.waitpid(pid, 0)
        print(os.waitstatus_to_exitcode(status), file=answers, flush=True)


if __name__ == "__main__":
    _serve()
