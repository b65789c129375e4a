"""Shards in processes, here or on a cluster: what one of them does, and looking after them."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NoReturn

from cei_converters.cli import quiet_libraries
from cei_converters.conversion.converter import Converter
from cei_converters.conversion.executors import quiet, run_local, run_ray
from cei_converters.conversion.plan import Plan
from cei_converters.conversion.shard import ShardWriter, frames_done, unfinished
from cei_converters.conversion.staging import StagingDirectory
from cei_gym import extras
from cei_gym.errors import CEIError

_LOOK_S = 0.5
_THREADS = 2


def convert_shards(
    place: StagingDirectory, plan: Plan, converter: Converter, workers: int, done: Callable[[int], None]
) -> None:
    """Convert the shards that are not there yet, in processes of two threads each; in this one where that is enough.

    Args:
        place: where they are kept.
        plan: of the conversion, saved in there.
        converter: fitted, for shards converted in this process.
        workers: cores to use.
        done: called with the number of frames that are done, now and then.

    Raises:
        CEIError: an episode cannot be converted.
        OSError: a worker was killed.
    """
    run = {"local": run_local, "ray": run_ray}[plan.config.executor]
    missing = place.missing(len(plan.shards))
    processes = processes_for(workers, len(missing)) if run is run_local else min(workers, len(missing))
    with _watching(place, plan, done, mortal=run is run_local):
        if run is run_local and processes <= 1:
            for shard in missing:
                convert_shard(converter, plan, place, shard, workers)
        elif missing:
            threads = -(-workers // processes) if run is run_local else 1
            task = ShardTask(str(place.root), missing, threads)
            run(task, len(missing), processes, place.logs / str(time.time_ns()))
    place.check_complete(len(plan.shards))


def default_workers() -> int:
    """How many cores a conversion keeps busy here: all of them; where nothing is installed that runs processes, those of one."""
    cores = os.cpu_count() or 1
    return cores if extras.missing("cluster") is None else min(cores, _THREADS)


def processes_for(workers: int, shards: int) -> int:
    """How many local processes keep as many cores busy. Two threads hardly wait for each other, and a process costs its imports."""
    return min(-(-workers // _THREADS), shards)


def convert_shard(converter: Converter, plan: Plan, place: StagingDirectory, shard: int, threads: int) -> None:
    """Convert one shard and put it in its place."""
    with ShardWriter(place.shard(shard)) as writer:
        for converted in converter.convert(plan.shards[shard], threads):
            writer.add(converted)


@dataclass(frozen=True)
class ShardTask:
    """What a worker gets: where to find the plan, and which shards there are to do."""

    root: str
    shards: list[int]
    threads: int

    def __setstate__(self, state: dict[str, Any]) -> None:
        quiet()  # a worker learns of its task before datatrove logs
        self.__dict__.update(state)

    def __call__(self, data: object = None, rank: int = 0, world_size: int = 1) -> None:
        """Convert the shard of this rank; what is wrong with an episode is left in the staging_directory, too."""
        with contextlib.suppress(ValueError):  # no main thread
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's business
        quiet_libraries()
        place = StagingDirectory(Path(self.root), resume=True)
        converter, plan = _opened(place.root)
        try:
            convert_shard(converter, plan, place, self.shards[rank], self.threads)
        except CEIError as error:
            place.note_error(self.shards[rank], error)
            raise


@lru_cache(maxsize=1)
def _opened(root: Path) -> tuple[Converter, Plan]:
    """A process's own converter, for all its shards."""
    place = StagingDirectory(root, resume=True)
    plan = Plan.load(place.plan)
    converter = Converter(plan.config, None if plan.config.dry_run else place.scratch)
    converter.start_from(plan.finalists, plan.correction)
    return converter, plan


class _WorkerLost(BaseException):
    """Interrupts whatever the main thread waits in; no library takes it for its own."""


@contextlib.contextmanager
def _watching(place: StagingDirectory, plan: Plan, done: Callable[[int], None], mortal: bool) -> Iterator[None]:
    """Report progress meanwhile, and stop where a worker dies, if they are `mortal`: a local pool would wait for it forever. Those of
    a cluster are looked after by it, and their process ids say nothing here."""
    over = threading.Event()
    frames = [sum(plan.frames[i] for i in positions) for positions in plan.shards]

    def watch() -> None:
        while not over.wait(_LOOK_S):
            whole = sum(frames[i] for i in range(len(frames)) if place.shard(i).exists())
            done(whole + frames_done(place.shards))
            if mortal and any(not _alive(pid) for pid in unfinished(place.shards)):
                os.kill(os.getpid(), signal.SIGUSR1)  # not SIGINT: shells have their background jobs ignore it
                return

    def stop(_signal: int, _frame: object) -> NoReturn:
        raise _WorkerLost

    mortal = mortal and threading.current_thread() is threading.main_thread()  # no other gets signals
    previous = signal.signal(signal.SIGUSR1, stop) if mortal else None
    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    except _WorkerLost:
        place.check_noted()  # where an episode is wrong, the pool ends the other workers
        message = "a worker was killed, maybe for want of memory; go on with --resume, and maybe fewer --workers."
        raise OSError(message) from None
    finally:
        over.set()
        watcher.join()
        if mortal:
            signal.signal(signal.SIGUSR1, previous)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
