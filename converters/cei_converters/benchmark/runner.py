"""Jobs in parallel processes."""

import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_converters import signals
from cei_converters.cli import quiet_libraries
from cei_gym.errors import CEIError, one_line


@dataclass(frozen=True)
class Job:
    """A call that another process makes, and the jobs that may start once it has succeeded."""

    name: str
    call: Callable[..., Any]
    args: tuple
    then: tuple["Job", ...] = ()


@dataclass(frozen=True)
class Outcome:
    """A finished job: its result, or in one line what it raised."""

    job: Job
    result: Any = None
    error: str | None = None


def run_jobs(jobs: Sequence[Job], workers: int) -> Generator[Outcome]:
    """Run jobs, and yield each as it finishes; close the iterator to stop at once.

    Raises:
        CEIError: a worker died.
    """
    # Workers inherit both. Cores are busy with other jobs; and stopped workers leave locks, of which Python would warn.
    os.environ["OMP_NUM_THREADS"] = "1"
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")
    # What others' modules take to import, some 8 s, is spent once, and not in every worker of every call. Ours may read the environment.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["lerobot.datasets.lerobot_dataset", "mujoco", "numba", "scipy.stats"])
    with ProcessPoolExecutor(workers, context, initializer=_start_worker, initargs=({**os.environ},)) as pool:
        with signals.spared():  # until they see to it themselves
            running = {pool.submit(_guarded, job): job for job in jobs}
        try:
            while running:
                done = wait(running, return_when=FIRST_COMPLETED).done
                # In the order of jobs: the order of a set is anybody's guess.
                for future in [each for each in running if each in done]:
                    job = running.pop(future)
                    result, error = future.result()
                    if error is None:
                        with signals.spared():
                            running |= {pool.submit(_guarded, following): following for following in job.then}
                    yield Outcome(job, result, error)
        except BrokenProcessPool:
            raise CEIError("a worker died, maybe for lack of memory; run again, with fewer --jobs.") from None
        finally:  # does nothing where all is done
            for process in multiprocessing.active_children() if running else ():
                process.terminate()
            pool.shutdown(cancel_futures=True)


def _start_worker(environment: Mapping[str, str]) -> None:
    """Leave the terminal, and Ctrl-C, to the main process, and end with it however that ends: nobody else would tell.

    Args:
        environment: the main process's variables, which are not those that the server of forks began with.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.clear()
    os.environ.update(environment)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    sys.stdout = sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115  (until the process ends)
    quiet_libraries()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _guarded(job: Job) -> tuple[Any, str | None]:
    """The result, or what went wrong: an exception of a library may not survive the way back."""
    try:
        return job.call(*job.args), None
    except CEIError as error:
        return None, one_line(error)
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return None, one_line(f"{type(error).__name__}: {error} ({Path(frame.filename).name}:{frame.lineno})")
