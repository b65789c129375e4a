"""Shards become a dataset, in a process of its own beside the conversion: LeRobot, which writes it, takes six seconds to import."""

import contextlib
import os
import signal
import threading
from collections import defaultdict
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Self

import numpy as np

from cei_converters import signals
from cei_converters.cli import quiet_libraries
from cei_converters.conversion.config import ConvertConfig
from cei_converters.conversion.converter import Converter, open_reader
from cei_converters.conversion.executors import START
from cei_converters.conversion.outcomes import Account, outcomes
from cei_converters.conversion.plan import Plan
from cei_converters.conversion.shard import Shard
from cei_converters.conversion.workplace import Workplace
from cei_converters.dataset.cameras import Pictures
from cei_converters.dataset.carried import Carried
from cei_converters.dataset.license import copy_license_files
from cei_converters.dataset.metadata import PICTURE_PATH, Environment, Metadata, Provenance, plain
from cei_converters.dataset.metadata import START as START_QPOS
from cei_converters.dataset.starts import middle
from cei_converters.dataset.writer import DatasetWriter, publish_dataset
from cei_gym.transfer import Transfer

_LOOK_S = 0.02


@dataclass(frozen=True)
class _Job:
    """What the process that writes gets.

    Attributes:
        root: of the dataset to make.
        shards: how many there will be.
        config: of the conversion.
        environment: what episodes replay in.
        provenance: how they come about.
        cameras: LeRobot's features of cameras whose pictures pass through.
        carried: LeRobot's features of what is carried over.
        tasks: those that have numbers already.
    """

    root: Path
    shards: int
    config: ConvertConfig
    environment: Environment
    provenance: Provenance
    cameras: dict[str, dict]
    carried: dict[str, dict]
    tasks: list[str]

    def write(self, connection: Connection) -> Path:
        """Append the episodes of each shard as soon as it is there; returns the folder that they are in.

        Raises:
            CEIError: pictures that pass through are missing.
            OSError: a shard is damaged.
        """
        place = Workplace(self.root, resume=True)
        partial = place.dataset.with_name(f"{place.dataset.name}-{os.getpid()}")  # another may go on where we are lost
        reader = open_reader(self.config) if self.cameras or self.carried or self.tasks else None
        with DatasetWriter(
            str(self.config.new_repo_id),
            self.root,
            environment=self.environment,
            clouds=plain(self.config.clouds),
            provenance=self.provenance,
            cameras=self.cameras,
            carried=self.carried,
            tasks=self.tasks,
            partial=partial,
        ) as writer:
            for number in range(self.shards):
                folder = place.shard(number)
                while not folder.exists():
                    _check_wanted(connection, _LOOK_S)
                shard = Shard(folder)
                shard.check()
                for converted in shard:
                    _check_wanted(connection)
                    if converted.encoded is None:
                        continue
                    index, frames = (
                        converted.outcome["entry"]["episode"],
                        converted.outcome["record"].get("source_frames"),
                    )
                    frames = None if frames is None else np.array(frames)
                    pictures = reader.pictures(index) if reader and self.cameras else Pictures()
                    carried = reader.carry(index) if reader else Carried()
                    writer.append(
                        converted.header,
                        converted.encoded,
                        converted.outcome["record"],
                        pictures.at(frames),
                        carried.at(frames),
                    )
        return partial


def _check_wanted(connection: Connection, wait_s: float = 0.0) -> None:
    """End this process, at once, if that which it works for has ended or wants it no more."""
    with contextlib.suppress(OSError):
        if not connection.poll(wait_s):
            return
    os._exit(1)


def _write(job: _Job, connection: Connection) -> None:
    """What the process does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's business
    quiet_libraries()
    try:
        found: Path | Exception = job.write(connection)
    except Exception as error:
        found = error
    with contextlib.suppress(OSError):
        connection.send(found)


class Assembly:
    """Context manager in whose block episodes are written as they are converted; what is unfinished at its end is given up.

    Args:
        place: where shards appear.
        plan: of the conversion.
        converter: fitted.
    """

    def __init__(self, place: Workplace, plan: Plan, converter: Converter) -> None:
        self._place, self._plan, self._converter = place, plan, converter
        reader = converter.reader
        self._job = _Job(
            place.root,
            len(plan.shards),
            plan.config,
            converter.environment,
            plan.provenance,
            dict(converter.cameras),
            dict(reader.carried),
            list(reader.tasks),
        )

    def __enter__(self) -> Self:
        import multiprocess

        context = multiprocess.get_context(START)  # pyright: ignore[reportAttributeAccessIssue]
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_write, args=(self._job, theirs), daemon=True)

        def start() -> None:  # it waits for the imports of the process that ours is forked from
            with contextlib.suppress(OSError, EOFError), signals.spared():
                self._process.start()
            theirs.close()

        self._starting = threading.Thread(target=start, daemon=True)
        self._starting.start()
        self._token = signals.begin(self._stop)
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        signals.end(self._token)

    def _stop(self) -> None:
        self._ours.close()  # by which the process knows
        if not self._starting.is_alive() and self._process.pid is not None:
            self._process.terminate()
            self._process.join()

    def finish(self, told: Account) -> None:
        """Complete the dataset, and move it to where it is wanted.

        Args:
            told: what became of the episodes.

        Raises:
            CEIError: pictures that pass through are missing.
            OSError: a shard is damaged, or the process that writes was killed.
        """
        from cei_converters.conversion.quality_picture import write_summary

        place, plan, converter = self._place, self._plan, self._converter
        picture = place.folder / PICTURE_PATH
        write_summary(picture, outcomes(place, plan), plan.config.gate, converter)
        partial = self._written()
        copy_license_files(converter.reader.root, partial)
        picture.rename(partial / PICTURE_PATH)
        header = Shard(place.shard(0)).header
        metadata = Metadata(
            embodiment=header.embodiment,
            scene=header.scene,
            environment=_with_start(converter.environment, outcomes(place, plan)),
            clouds=plain(plan.config.clouds),
            total_episodes=len(told.entries),
            provenance=_with_choices(plan.provenance, converter.transfer, told),
        )
        publish_dataset(partial, place.root, str(plan.config.new_repo_id), metadata)

    def _written(self) -> Path:
        try:
            found = self._ours.recv()
        except (EOFError, OSError):
            message = "the process that writes the dataset was killed, maybe for want of memory; go on with --resume."
            raise OSError(message) from None
        if isinstance(found, Exception):
            raise found
        return found


def _with_choices(provenance: Provenance, transfer: Transfer, told: Account) -> Provenance:
    """Provenance with what was decided on the way: where trajectories start, on which pads, which episodes are dropped."""
    pads = {e.name: plain(e.end_effector.pads) for e in (transfer.source, transfer.target) if e.end_effector}
    options = provenance.options | {"basins": plain(transfer.basins)}
    if told.verified is not None:
        options["verify"] = options["verify"] | {"dropped": told.verified["dropped"]}
    if told.judged is not None:
        options["gate"] = told.judged
    return replace(provenance, pads=pads, options=options)


def _with_start(environment: Environment, found: Any) -> Environment:
    """The environment with episodes that start where the demonstrations of each mode do: a policy knows no other way."""
    if environment.id is None:
        return environment
    starts: dict[int, list[list[float]]] = defaultdict(list)
    for outcome in found:
        if not outcome["left_out"]:
            starts[outcome["mode"]].append(outcome["start_qpos"])
    middles = [middle(qpos) for _, qpos in sorted(starts.items())]
    return replace(environment, kwargs=environment.kwargs | {START_QPOS: middles})
