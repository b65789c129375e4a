"""How long it takes from nothing to an environment's first observation: the first time on a machine, and every time after it.

usage: python benchmarks/start_up.py [EMBODIMENT ...] [--task PickCube] [--repeats 5] [--results DIR]

Embodiments: by default two that robosuite mounts and, where their descriptions are in ../shared/robots, two that it does not. Each start is a process
of its own. The first has neither Python's byte code nor numba's compiled kernels; the others have what it left. Seconds on the clock, which other programs
lengthen, and of the processor. Writes start_up.json.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from measure import save
from rich.console import Console
from rich.table import Table

SHARED = Path(__file__).parents[2] / "shared/robots"
MOUNTED = ["Panda-PandaGripper", "IIWA-Inspire"]
COMPOSED = ["XArm7-AllegroHand", "XArm7-PandaGripper"]
STAGES = ["import", "make", "reset"]
START = """
import json, sys, time
started = time.perf_counter()
import gymnasium, cei_gym
imported = time.perf_counter()
env = gymnasium.make(sys.argv[1])
made = time.perf_counter()
env.reset(seed=0)
print(json.dumps({"import": imported - started, "make": made - imported, "reset": time.perf_counter() - made, "processor": time.process_time()}))
"""
"""One start, in seconds."""


def start(env_id: str, environment: dict[str, str]) -> dict[str, float]:
    """Seconds of a start, as a whole and by stages."""
    begun = perf_counter()
    done = subprocess.run([sys.executable, "-c", START, env_id], env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{env_id}: {(done.stderr.strip() or 'ended').splitlines()[-1]}")
    found = {"total": perf_counter() - begun, **json.loads(done.stdout.splitlines()[-1])}
    return {name: round(seconds, 2) for name, seconds in found.items()}


def measure(env_id: str, repeats: int) -> dict[str, Any]:
    """A first start, and the median of those after it."""
    with tempfile.TemporaryDirectory() as caches:
        kept = {
            "PYTHONDONTWRITEBYTECODE": "",
            "PYTHONPYCACHEPREFIX": f"{caches}/python",
            "NUMBA_CACHE_DIR": f"{caches}/numba",
        }
        first = start(env_id, os.environ | kept)
        later = [start(env_id, os.environ | kept) for _ in range(repeats)]
    return {"first": first, "later": {name: round(float(np.median([s[name] for s in later])), 2) for name in first}}


def main() -> None:
    """Measure, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("embodiments", nargs="*", metavar="EMBODIMENT")
    parser.add_argument("--task", default="PickCube")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--results", type=Path, default=Path("results/robots"))
    options = parser.parse_args()
    rows: dict[str, Any] = {}
    if SHARED.is_dir():
        given = os.environ.get("CEI_GYM_PACKAGE_PATH")
        os.environ["CEI_GYM_PACKAGE_PATH"] = os.pathsep.join(filter(None, (given, str(SHARED))))
    for name in options.embodiments or [*MOUNTED, *(COMPOSED if SHARED.is_dir() else [])]:
        rows[name] = measure(f"CEI-{options.task}-{name}", options.repeats)
    save(
        options.results / "start_up.json",
        {"task": options.task, "repeats": options.repeats, "robots": rows},
        seeds=(0, 0),
    )
    table = Table("seconds", "first", "later", *(f"later: {stage}" for stage in STAGES), "later: processor")
    for name, row in rows.items():
        shown = [row["first"]["total"], row["later"]["total"], *(row["later"][key] for key in (*STAGES, "processor"))]
        table.add_row(name, *(f"{seconds:.1f}" for seconds in shown))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
