"""Entry points of the commands: signals are heeded from the first moment, and imports, which take seconds, come after that."""

import importlib
import importlib.util
import os
import sys
from functools import partial
from pathlib import Path

from cei_converters import signals


def run(module: str, command: str, extra: str | None = None, bring: str | None = None) -> int:
    """Run the `main` of one of our modules as a process of its own; returns the exit code.

    Args:
        module: its name.
        command: what it is called.
        extra: of `cei_gym.extras`, without which it can do nothing.
        bring: the extra to install for that, if it is another.
    """
    signals.own()
    _know_glfw()
    code = _main(module, command, extra, bring)
    signals.finished(code)
    if signals.received() is not None:  # everything is tidied up: what Python does at its end may wait for threads
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def _main(module: str, command: str, extra: str | None, bring: str | None) -> int:
    from cei_gym import extras

    try:
        if extra is not None:
            extras.require(command, extra, bring)
        with extras.needed_by(command):
            main = importlib.import_module(f"{__package__}.{module}").main
    except extras.MissingExtra as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return main()


def _know_glfw() -> None:
    """Say where GLFW is, which nothing here uses but MuJoCo imports: it would start another Python to find out, and a terminal's Ctrl-C
    would reach that, too."""
    spec = importlib.util.find_spec("glfw")
    for folder in (spec and spec.submodule_search_locations) or ():
        for library in sorted(Path(folder).rglob("libglfw*.*"), reverse=True):  # x11 rather than wayland
            os.environ.setdefault("PYGLFW_LIBRARY", str(library))


_LEROBOT = "lerobot"
record = partial(run, "record", "cei-record", _LEROBOT)
convert = partial(run, "convert", "cei-convert", _LEROBOT)
inspect = partial(run, "inspection.command", "cei-inspect", _LEROBOT)
replay = partial(run, "replay", "cei-replay", _LEROBOT)
report = partial(run, "report.command", "cei-report", _LEROBOT)
restore = partial(run, "restore", "cei-restore", _LEROBOT)
calibrate = partial(run, "calibrate", "cei-calibrate", _LEROBOT)
pads = partial(run, "pads", "cei-pads")
robot = partial(run, "robot.command", "cei-robot")
view = partial(run, "view.command", "cei-view", _LEROBOT, "view")
benchmark = partial(run, "benchmark.command", "cei-benchmark", _LEROBOT)

if __name__ == "__main__":  # of a module that has no entry point of its own: python -m cei_converters.start demo
    name = sys.argv.pop(1)
    sys.exit(run(name, f"python -m {__package__}.{name}", _LEROBOT))
