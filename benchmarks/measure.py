"""What several benchmarks need: a clock, MuJoCo's own renderer where there is a GL library, files for their results and what they depend on."""

import argparse
import contextlib
import importlib
import json
import os
import platform
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
from mujoco.rendering.classic import gl_context

from cei_converters.benchmark.keeping import Run, keep
from cei_converters.dataset.provenance import PACKAGES

STARTED = Run.now((*PACKAGES, "numba", "lerobot_policy_dp3"))
"""What this process runs, whatever becomes of the files meanwhile."""


def milliseconds(call: Callable, repeats: int) -> dict[str, float]:
    """Median and 99th percentile, after a first call that compiles."""
    call()
    times_ms = []
    for _ in range(repeats):
        start = perf_counter()
        call()
        times_ms.append(1e3 * (perf_counter() - start))
    return {"median": round(float(np.median(times_ms)), 2), "p99": round(float(np.percentile(times_ms, 99)), 2)}


def use_gl() -> bool:
    """Have `mujoco.Renderer` draw without a window, whoever imported MuJoCo first; False without a GL library."""
    for backend in ("egl", "osmesa"):
        try:
            context = importlib.import_module(f"mujoco.{backend}").GLContext
            context(16, 16).free()
        except Exception as error:  # PyOpenGL and ctypes fail in many ways without a library
            print(f"no {backend}: {error}")
            continue
        gl_context.GLContext = context
        return True
    return False


def save(path: Path, result: dict, *beside: str, seeds: Sequence[int] | None = None) -> None:
    """Write a result as JSON, with the machine, the versions and the commit that gave it.

    Args:
        path: of the file.
        result: its content.
        beside: names of files that are made of it, in the same folder.
        seeds: first and last; default: the result's own.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    made_by = {"cpu": cpu(), "versions": STARTED.versions, "commit": STARTED.commit}
    path.write_text(json.dumps(result | made_by, indent=1) + "\n")
    say_of(path.parent, [path.name, *beside], seeds or result.get("seeds"))


def say_of(folder: Path, files: Iterable[str], seeds: Sequence[int] | None) -> None:
    """Say in the folder's `depends.yaml` what files depend on that this process makes.

    Args:
        folder: of results.
        files: their names.
        seeds: first and last.
    """
    keep(folder, files, command(), STARTED, seeds)


def command() -> str:
    """This process's command, less where it puts things."""
    script, *rest = sys.argv
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for option in ("--results", "--work"):
        parser.add_argument(option)
    return shlex.join(["python", f"benchmarks/{Path(script).name}", *parser.parse_known_args(rest)[1]])


def cpu() -> str:
    """Cores and model of this machine's processor."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return f"{os.cpu_count()} x {line.partition(':')[2].strip()}"
    return f"{os.cpu_count()} x {platform.processor()}"
