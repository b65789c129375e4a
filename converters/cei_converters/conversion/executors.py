"""Who runs the shards: datatrove's executors, by name. One shard is one of their tasks."""

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cei_converters import signals
from cei_gym import extras
from cei_gym.errors import CEIError

NAMES = ("local", "slurm", "ray")
START = "forkserver"


@dataclass
class SlurmOptions:
    """Options of `--executor=slurm`; workers are as many jobs at a time.

    Attributes:
        partition: where to run.
        time: limit of a shard, [days-]hours:minutes:seconds.
        mem_gb: memory of a job.
        qos: quality of service.
    """

    partition: str | None = None
    time: str = "12:00:00"
    mem_gb: int = 8
    qos: str = "normal"

    def __post_init__(self) -> None:
        if self.mem_gb < 1:
            raise CEIError(f"--slurm.mem_gb={self.mem_gb} should be at least 1.")


def check_executor(name: str, slurm: SlurmOptions) -> None:
    """Fail before any work is done, not after it.

    Raises:
        CEIError: what it needs is not there.
    """
    import shutil

    if name == "ray":
        extras.require("--executor=ray", "ray")
    if name != "local":
        extras.require(f"--executor={name}", "cluster")
    if name == "slurm":
        if slurm.partition is None:
            raise CEIError("--executor=slurm needs --slurm.partition.")
        if shutil.which("sbatch") is None:
            raise CEIError("--executor=slurm: there is no sbatch here; run this where jobs are submitted.")


def run_local(task: Callable, tasks: int, workers: int, logs: Path) -> None:
    """Run in processes of this machine, and return when they are done."""
    from datatrove.executor import LocalPipelineExecutor
    from multiprocess import forkserver

    quiet()
    with signals.spared():
        forkserver.ensure_running()
    with _children_leave():
        LocalPipelineExecutor([task], tasks, workers, str(logs), skip_completed=False, start_method=START).run()


def run_ray(task: Callable, tasks: int, workers: int, logs: Path) -> None:
    """On a Ray cluster, the running one or one of this machine's cores; returns when they are done or failed."""
    import ray
    from datatrove.executor import RayPipelineExecutor

    quiet()
    if not ray.is_initialized():
        ray.init(log_to_driver=False)
    RayPipelineExecutor([task], tasks, workers, logging_dir=str(logs), skip_completed=False, mem_per_cpu_gb=0.5).run()


def submit_slurm(task: Callable, then: Callable, tasks: int, workers: int, logs: Path, options: SlurmOptions) -> str:
    """As an array of Slurm jobs, and one that follows them; returns that one's id at once."""
    import sys

    from datatrove.executor import SlurmPipelineExecutor

    quiet()

    def job(name: str, call: Callable, count: int, after: Any, **more: Any) -> Any:
        return SlurmPipelineExecutor(
            [call],
            count,
            options.time,
            str(options.partition),
            mem_per_cpu_gb=options.mem_gb,
            qos=options.qos,
            venv_path=str(Path(sys.prefix, "bin/activate")),
            job_name=name,
            logging_dir=str(logs / name),
            slurm_logs_folder=str(logs / "slurm"),
            skip_completed=False,
            requeue=False,
            depends=after,
            **more,
        )

    last = job(
        "cei-assemble", then, 1, job("cei-convert", task, tasks, None, workers=workers), run_on_dependency_fail=True
    )
    last.run()
    return str(last.job_id)


def warm_up(*modules: str) -> None:
    """Begin to import modules in a process of its own, which local workers are forked from."""
    import multiprocess
    from multiprocess import forkserver

    multiprocess.get_context(START).set_forkserver_preload(list(modules))  # pyright: ignore[reportAttributeAccessIssue]
    with signals.spared():
        forkserver.ensure_running()


@contextlib.contextmanager
def _children_leave() -> Iterator[None]:
    """Processes forked meanwhile end with this one, however that ends: datatrove's manager would stay forever, all our memory
    with it."""
    parent, over = os.getpid(), threading.Event()

    def leave() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    def in_child() -> None:
        if not over.is_set():
            threading.Thread(target=leave, daemon=True).start()

    os.register_at_fork(after_in_child=in_child)  # for good; hence the event
    try:
        yield
    finally:
        over.set()


def quiet() -> None:
    """Keep datatrove from logging to the terminal."""
    from loguru import logger

    logger.disable("datatrove")
