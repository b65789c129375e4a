"""Where a conversion keeps what it has done until its dataset is published: a hidden folder beside that."""

import contextlib
import shutil
import sys
from pathlib import Path
from typing import Self

from filelock import FileLock, Timeout

from cei_converters.conversion.shard import Shard
from cei_gym.errors import CEIError


class Workplace:
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
        root = root.absolute()
        self.root, self._resume, self._kept, self._begun = root, resume, False, False
        self.folder = _hidden(root)
        self.plan = self.folder / "plan.json"
        self.shards = self.folder / "shards"
        self.logs = self.folder / "logs"
        self.dataset = self.folder / "dataset"
        self._new_folders: list[Path] = []

    def __enter__(self) -> Self:
        if self.root.exists():
            raise CEIError(f"{self.root} already exists; choose another folder or remove it first.")
        self._new_folders = [f for f in (self.folder, *self.folder.parents) if not f.exists()]
        self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = FileLock(self.folder / "lock")
        try:
            self._lock.acquire(timeout=0)
        except Timeout:
            raise CEIError(f"another cei-convert is making {self.root}; choose another folder.") from None
        try:
            if self.root.exists():  # finished by the other just now
                raise CEIError(f"{self.root} already exists; choose another folder or remove it first.")
            if self.plan.exists() and not self._resume:
                raise CEIError(
                    f"a conversion to {self.root} was begun and not finished; go on with --resume, or remove {self.folder}."
                )
        except CEIError:
            if not self.plan.exists():
                shutil.rmtree(self.folder, ignore_errors=True)
            self._lock.release()
            raise
        self._begun = self.plan.exists()
        for path in self.folder.iterdir():
            if path.name != "lock" and not self._begun:
                _remove(path)
        for path in (*self.shards.glob(".*"), *self.folder.glob("error-*")):  # of workers that were killed, or failed
            _remove(path)
        return self

    def keep(self) -> None:
        """Leave everything in place when the block ends: others go on with it."""
        self._kept = True

    def missing(self, shards: int) -> list[int]:
        """Those of the first `shards` that are not there; damaged ones are removed."""
        return [shard for shard in range(shards) if not self._finished(shard)]

    def check_complete(self, shards: int) -> None:
        """Check that shards are there.

        Raises:
            CEIError: what is wrong with an episode of a missing one.
            OSError: workers did not make one, and left no reason.
        """
        missing = [shard for shard in range(shards) if not self.shard(shard).exists()]
        for shard in missing:
            if (noted := self._error(shard)).exists():
                raise CEIError(noted.read_text())
        if missing:
            raise OSError(
                f"{len(missing)} of {shards} shards were not converted; see {self.logs}, and go on with --resume."
            )

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
        """Its folder."""
        return self.shards / f"{shard:06d}"

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> None:
        interrupted = kind is not None and issubclass(kind, (KeyboardInterrupt, OSError))
        keep = self._kept or (interrupted and any(self.shards.glob("[0-9]*"))) or (kind is not None and self._begun)
        if keep and interrupted:
            print(f"What is done is kept in {self.folder}: the same command with --resume goes on.", file=sys.stderr)
        if not keep:
            shutil.rmtree(self.folder, ignore_errors=True)
        self._lock.release()
        if not keep:
            for folder in self._new_folders:
                with contextlib.suppress(OSError):  # not empty: the dataset is in it
                    folder.rmdir()


def tidy(root: Path) -> None:
    """Remove what is left beside a finished dataset, of a process that was killed as soon as it had published it."""
    folder = _hidden(root.absolute())
    if folder.exists():
        with contextlib.suppress(Timeout), FileLock(folder / "lock", timeout=0):  # else it is about to do so itself
            shutil.rmtree(folder, ignore_errors=True)


def _hidden(root: Path) -> Path:
    return root.parent / f".{root.name}.partial"


def _remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
