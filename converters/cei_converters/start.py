"""Entry points of the commands: signals are heeded from the first moment, and imports, which take seconds, come after that."""

import importlib
import importlib.util
import os
import sys
from functools import partial
from pathlib import Path

from cei_converters import signals


def run(module: str) -> int:
    """Run the `main` of one of our modules as a process of its own; returns the exit code."""
    signals.own()
    _know_glfw()
    code = importlib.import_module(f"{__package__}.{module}").main()
    signals.finished(code)
    if signals.received() is not None:  # everything is tidied up: what Python does at its end may wait for threads
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def _know_glfw() -> None:
    """Say where GLFW is, which nothing here uses but MuJoCo imports: it would start another Python to find out, and a terminal's Ctrl-C
    would reach that, too."""
    spec = importlib.util.find_spec("glfw")
    for folder in (spec and spec.submodule_search_locations) or ():
        for library in sorted(Path(folder).rglob("libglfw*.*"), reverse=True):  # x11 rather than wayland
            os.environ.setdefault("PYGLFW_LIBRARY", str(library))


record = partial(run, "record")
convert = partial(run, "convert")
inspect = partial(run, "inspection.command")
replay = partial(run, "replay")
restore = partial(run, "restore")
pads = partial(run, "pads")
view = partial(run, "view.command")
benchmark = partial(run, "benchmark.command")

if __name__ == "__main__":  # of a module that has no entry point of its own: python -m cei_converters.start demo
    sys.exit(run(sys.argv.pop(1)))
