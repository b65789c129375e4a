"""Shards become the files of a dataset, in a process of its own beside the conversion: LeRobot, which writes them, takes six seconds to
import.

`Writing` starts the process and tells it what to do in a line of JSON; it answers in one, when all is written. That the pipe ends
tells it that nobody waits for it any more. Where LeRobot is imported already, as in a second conversion of one process, none is started.
"""

import contextlib
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from cei_converters import signals
from cei_gym.errors import CEIError

if TYPE_CHECKING:
    from cei_converters.conversion.episode import Converted
    from cei_converters.conversion.staging import StagingDirectory

_LOOK_S = 0.02
_LEROBOT = "lerobot.datasets"


class Writing:
    """Context manager of the process. It begins its imports at once; in the end it is gone, whether it is done or not."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._job: tuple[Path, dict[str, Any]] | None = None

    def __enter__(self) -> Self:
        self._token = signals.begin(self._stop)
        if _LEROBOT in sys.modules:
            return self
        paths = os.pathsep.join(str(Path(path or ".").resolve()) for path in sys.path)
        with signals.spared():
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=os.environ | {"PYTHONPATH": paths},
                text=True,
            )
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        signals.end(self._token)

    def _stop(self) -> None:
        if self._process is None:
            return
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()

    def begin(self, root: Path, **known: Any) -> None:
        """Have it append the episodes of each shard as soon as it is there.

        Args:
            root: of the dataset to make, whose plan is saved.
            known: JSON types, the other arguments of `write`.
        """
        self._job = root, known
        if self._process is not None:
            assert self._process.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # `result` will tell
                self._process.stdin.write(json.dumps({"root": str(root), **known}) + "\n")
                self._process.stdin.flush()

    def result(self) -> Path:
        """The folder that the episodes are in, once they are.

        Raises:
            CEIError: a video that pictures pass through from is not there any more.
            OSError: a shard is damaged, the disk is full, or the process was killed.
        """
        assert self._job is not None
        if self._process is None:
            root, known = self._job
            return write(root, **known)
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
        if not answer:
            raise OSError(
                "the process that writes the dataset was killed, maybe for want of memory; go on with --resume."
            )
        found = json.loads(answer)
        if "folder" in found:
            return Path(found["folder"])
        raise (CEIError if found["ours"] else OSError)(found["error"])


def write(
    root: Path,
    environment: dict[str, Any],
    cameras: dict[str, dict[str, Any]],
    carried: dict[str, dict[str, Any]],
    tasks: list[str],
    go_on: Callable[[float], None] = lambda _: None,
) -> Path:
    """What the process does; see `Writing`.

    Args:
        root: of the dataset to make, whose plan is saved.
        environment: what episodes replay in.
        cameras: LeRobot's features of cameras whose pictures pass through.
        carried: LeRobot's features of what is carried over.
        tasks: those that have numbers already.
        go_on: called now and then, with how many seconds there is nothing to do; it ends the process if it is not to go on.

    Returns:
        The folder that the episodes are in.

    Raises:
        CEIError: a video that pictures pass through from is not there any more.
        OSError: a shard is damaged, or the disk is full.
    """
    import draccus

    from cei_converters.conversion.plan import Plan
    from cei_converters.conversion.staging import StagingDirectory
    from cei_converters.dataset.metadata import Environment, plain
    from cei_converters.dataset.writer import DatasetWriter

    place = StagingDirectory(root, resume=True)
    plan = Plan.load(place.plan)
    config = plan.config
    cameras, carried = (
        {key: feature | {"shape": tuple(feature["shape"])} for key, feature in features.items()}
        for features in (cameras, carried)
    )
    with DatasetWriter(
        str(config.new_repo_id),
        place.root,
        environment=draccus.decode(Environment, environment),
        clouds=plain(config.clouds),
        provenance=plan.provenance,
        cameras=cameras,
        carried=carried,
        tasks=tasks,
        partial=place.dataset.with_name(f"{place.dataset.name}-{os.getpid()}"),  # another may go on where we are lost
    ) as writer:
        for converted in _converted(place, len(plan.shards), go_on):
            if converted.encoded is not None:
                writer.append(converted.header, converted.encoded, converted.outcome.record)
    return writer.partial


def _converted(place: "StagingDirectory", shards: int, go_on: Callable[[float], None]) -> Iterator["Converted"]:
    """The episodes of all shards, once each is there."""
    from cei_converters.conversion.shard import Shard

    for number in range(shards):
        folder = place.shard(number)
        while not folder.exists():
            go_on(_LOOK_S)
        shard = Shard(folder)
        shard.check()
        for converted in shard:
            go_on(0.0)
            yield converted


def _check_wanted(wait_s: float) -> None:
    """End this process, at once and as it is, if nobody waits for it any more."""
    if select.select([sys.stdin], [], [], wait_s)[0]:  # nothing more is said, so it is the end
        os._exit(1)


def main() -> None:
    """The process."""
    from cei_converters.cli import quiet_libraries

    quiet_libraries()
    answers, sys.stdout = sys.stdout, sys.stderr  # whatever a library prints is no answer
    import datasets  # noqa: F401
    import lerobot.datasets  # noqa: F401

    job = sys.stdin.readline()
    if not job:
        return
    told = json.loads(job)
    try:
        answer = {"folder": str(write(Path(told.pop("root")), **told, go_on=_check_wanted))}
    except (CEIError, OSError) as error:
        answer = {"error": str(error), "ours": isinstance(error, CEIError)}
    print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
