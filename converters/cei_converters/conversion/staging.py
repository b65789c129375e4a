"""Where a conversion keeps what it has done until its dataset is published: a hidden folder beside that."""

import shutil
import sys
from pathlib import Path
from typing import Self

from cei_converters import signals
from cei_converters.conversion.shard import Shard
from cei_converters.dataset.place import PLAN, HiddenFolder, remove
from cei_gym.errors import CEIError


class StagingDirectory:
    """Context manager that holds the folder, for one process at a time.

    What is interrupted stays, for `--resume`, once a shard is finished, and what was there before stays whatever happens. What
    is begun and goes wrong does not.

    Args:
        root: of the dataset to make.
        resume: whether to go on with what is there.

    Raises:
        CEIError: the dataset exists, another process makes it, or something unfinished is there and not to be resumed.
    """

    def __init__(self, root: Path, resume: bool) -> None:
        self._hidden = HiddenFolder(root, "cei-convert")
        self.root, self.folder = self._hidden.root, self._hidden.path
        self._resume, self._kept = resume, False
        self.plan = self.folder / PLAN
        self.shards = self.folder / "shards"
        self.logs = self.folder / "logs"
        self.dataset = self.folder / "dataset"
        self.scratch = self.folder / "scratch"
        self._left, self._token = False, object()

    def __enter__(self) -> Self:
        self._token = signals.begin(lambda: self._leave(KeyboardInterrupt))
        try:
            self._hidden.acquire(self._resume)
        except Exception:
            signals.end(self._token)
            raise
        for path in (
            *self.shards.glob(".*"),
            *self.folder.glob("error-*"),
            *self.folder.glob(f"{self.dataset.name}-*"),
            *self.folder.glob(self.scratch.name),
        ):  # of workers that were killed, or failed
            remove(path)
        return self

    def keep(self) -> None:
        """Leave everything in place when the block ends: others go on with it."""
        self._kept = True

    def missing(self, shards: int) -> list[int]:
        """Find those of the first `shards` that are not there, and remove damaged ones."""
        return [shard for shard in range(shards) if not self._finished(shard)]

    def check_complete(self, shards: int) -> None:
        """Check that shards are there.

        Raises:
            CEIError: what is wrong with an episode of a missing one.
            OSError: workers did not make one, and left no reason.
        """
        missing = [shard for shard in range(shards) if not self.shard(shard).exists()]
        if missing:
            self.check_noted()
            raise OSError(
                f"{len(missing)} of {shards} shards were not converted; see {self.logs}, and go on with --resume."
            )

    def check_noted(self) -> None:
        """Check that no worker left word.

        Raises:
            CEIError: what is wrong with an episode.
        """
        for noted in sorted(self.folder.glob("error-*")):
            raise CEIError(noted.read_text())

    def note_error(self, shard: int, error: Exception) -> None:
        """Leave word of what is wrong with an episode, for another process to tell."""
        self._error(shard).write_text(str(error))

    def _error(self, shard: int) -> Path:
        return self.folder / f"error-{shard:06d}"

    def _finished(self, shard: int) -> bool:
        try:
            Shard(self.shard(shard)).check()
        except OSError:
            shutil.rmtree(self.shard(shard), ignore_errors=True)
            return False
        return True

    def shard(self, shard: int) -> Path:
        """The folder of a shard."""
        return self.shards / f"{shard:06d}"

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> None:
        self._leave(kind)
        signals.end(self._token)

    def _leave(self, kind: type[BaseException] | None) -> None:
        interrupted = kind is not None and issubclass(kind, (KeyboardInterrupt, OSError))
        keep = (
            self._kept or (interrupted and any(self.shards.glob("[0-9]*"))) or (kind is not None and self._hidden.begun)
        )
        if keep and interrupted and not self._left:
            print(f"What is done is kept in {self.folder}: the same command with --resume goes on.", file=sys.stderr)
        self._left = True
        self._hidden.release(keep)
