"""Where a dataset is to be: whether it can be there, and the hidden folder beside it in which it is made."""

import contextlib
import json
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from cei_converters import signals
from cei_converters.dataset.locate import INFO_PATH
from cei_gym.errors import CEIError, one_line

PLAN = "plan.json"
"""Of a conversion that can be gone on with; what its folder holds is removed by nobody but who asks for it."""
_LOCK, _OWNER = "lock", "owner.json"
_MARKS = (INFO_PATH, ".zgroup", "zarr.json")
_LEAST_BYTES = 100_000


def check_place(root: Path) -> None:
    """Check that a new dataset can be made there.

    Raises:
        CEIError: something is there, it is inside another dataset, or the folder cannot be made.
    """
    where = absent(root)
    if (around := dataset_around(where)) is not None:
        raise CEIError(f"{root} is inside the dataset {around}; choose a folder outside of it.")
    check_parent(_hidden(where), str(root))  # whose name is the longer one
    if shutil.disk_usage(nearest(where)).free < _LEAST_BYTES:
        raise CEIError(f"{root}: the disk is full.")


def absent(root: Path) -> Path:
    """A folder that is to be made, absolute, with no links on the way to it.

    Raises:
        CEIError: something is there already, be it a link that leads nowhere.
    """
    try:
        where = root.parent.resolve() / root.name
        if where.is_symlink() and not where.exists():
            raise CEIError(f"{root} is a link to {where.readlink()}, which is not there; choose another folder.")
        if os.path.lexists(where):
            raise CEIError(f"{root} already exists; choose another folder or remove it first.")
    except (OSError, RuntimeError) as error:
        raise CEIError(f"{root} can be no folder: {one_line(error)}.") from error
    return where


def check_parent(path: Path, what: str = "") -> None:
    """Check that a file or folder could be made, with the folders that it needs.

    Args:
        path: of it.
        what: it is called in messages; by its path if not said.

    Raises:
        CEIError: what it should be in is no folder, must not be written to, or a name is too long.
    """
    folder, what = nearest(path), what or str(path)
    if not folder.is_dir():
        raise CEIError(f"{what} cannot be made: {folder} is no folder.")
    try:
        for missing in path.absolute().relative_to(folder).parts:
            with contextlib.suppress(FileNotFoundError):
                os.lstat(folder / missing)  # says so if a name is too long
        tempfile.TemporaryFile(dir=folder).close()  # a mount may be read-only, whatever permissions say
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise CEIError(f"{what} cannot be made in {folder}: {reason}.") from error


def nearest(path: Path) -> Path:
    """What is there on the way to a path that is not."""
    return next(parent for parent in path.absolute().parents if os.path.lexists(parent))


def dataset_around(path: Path) -> Path | None:
    """The dataset that a path leads into, links followed; None if it leads into none."""
    for folder in path.resolve().parents:
        if any(os.path.isfile(folder / mark) for mark in _MARKS):  # noqa: PTH113  (which minds no folder that is closed to us)
            return folder
    return None


def inside_new(root: Path, path: Path) -> bool:
    """Whether a path leads into a dataset that is to be made, or into the folder in which it is made."""
    where = root.parent.resolve() / root.name
    return any(path.resolve().is_relative_to(folder) for folder in (where, _hidden(where)))


class HiddenFolder:
    """The folder beside a new dataset that holds what is unfinished, for one process at a time.

    What a killed process left is removed by the next that makes a dataset in the same folder, unless it can be gone on with (`PLAN`).
    Whether a process is alive is told by its lock, which the system takes from the dead; what it knows nothing of, those of other
    machines, stays.

    Args:
        root: of the dataset.
        maker: command that makes it, for messages.

    Attributes:
        begun: whether there was something to go on with.
    """

    def __init__(self, root: Path, maker: str) -> None:
        self.root, self._maker = root.absolute(), maker
        self.path = _hidden(self.root)
        self._lock = FileLock(self.path / _LOCK, thread_local=False)  # whoever tidies up may release it
        self.begun = False
        self._new_folders: list[Path] = []

    def acquire(self, resume: bool = False) -> None:
        """Make it, or take over what is there: a killed process's, whose files are removed unless they can be gone on with.

        Args:
            resume: go on with what can be gone on with.

        Raises:
            CEIError: the dataset exists, cannot be made, or is being made by another process; or something was begun and is not to
                be gone on with, or is not ours.
        """
        check_place(self.root)
        with signals.held():  # until it has an owner, nobody would remove it
            folders = (self.path, *self.path.parents)
            self._new_folders = [folder for folder in folders if not folder.exists()]
            try:
                self.path.mkdir(parents=True, exist_ok=True)
                self._lock_ours()
            except (CEIError, OSError):
                self._remove_new()
                raise
            self.begun = (self.path / PLAN).exists()
            try:
                absent(self.root)  # finished by the other just now
                if self.begun and not resume:
                    raise CEIError(
                        f"a conversion to {self.root} was begun and not finished; go on with --resume, or remove {self.path}."
                    )
            except CEIError:
                self.release(keep=self.begun)
                raise
            (self.path / _OWNER).write_text(json.dumps(_here()))
        for path in [] if self.begun else self.path.iterdir():
            if path.name not in (_LOCK, _OWNER):
                remove(path)
        for folder in self.path.parent.glob(".*.partial"):
            if folder != self.path:
                _sweep(folder)

    def release(self, keep: bool) -> None:
        """Leave it to others, or remove it with the folders that were made for it and are empty; does nothing if it is not held."""
        if not self._lock.is_locked:
            return
        if not keep:
            _remove_hidden(self.path)
        self._lock.release()
        if not keep:
            self._remove_new()

    def _lock_ours(self) -> None:
        self._check_ours()
        try:
            self._lock.acquire(timeout=0)
        except Timeout:
            raise CEIError(f"another {self._maker} is making {self.root}; choose another folder.") from None
        try:
            self._check_ours()  # now that nobody changes it
        except CEIError:
            self._lock.release()
            raise

    def _check_ours(self) -> None:
        found = {path.name for path in self.path.iterdir()}
        if PLAN in found or found <= {_LOCK}:
            return
        owner = _owner(self.path)
        if owner is None:
            raise CEIError(f"{self.path} is in the way, and none of our commands made it; choose another folder.")
        if not _is_here(owner):
            raise CEIError(
                f"{self.root} is, or was, being made on {owner['host']}; if that has ended, remove {self.path}."
            )

    def _remove_new(self) -> None:
        for folder in self._new_folders:
            with contextlib.suppress(OSError):  # not empty: the dataset is in it; or never made
                folder.rmdir()


def _sweep(folder: Path) -> None:
    """Remove a hidden folder if it is of a process of this machine that was killed, and cannot be gone on with."""
    owner = _owner(folder)
    if owner is None or not _is_here(owner) or (folder / PLAN).exists():
        return
    with contextlib.suppress(OSError, Timeout), FileLock(folder / _LOCK, timeout=0):
        if not (folder / PLAN).exists():
            _remove_hidden(folder)


def _remove_hidden(folder: Path) -> None:
    """Remove a hidden folder, last what tells that it is one of ours: whoever is killed meanwhile leaves what the next may remove."""
    last = [folder / name for name in (PLAN, _OWNER, _LOCK)]
    for path in [*(path for path in folder.glob("*") if path not in last), *last]:
        with contextlib.suppress(OSError):
            remove(path)
    shutil.rmtree(folder, ignore_errors=True)


def _here() -> dict[str, str]:
    """This machine: its name, which containers may change, and what its kernel is called until it is started again."""
    boot = Path("/proc/sys/kernel/random/boot_id")
    return {"host": socket.gethostname(), "boot": boot.read_text().strip() if boot.is_file() else ""}


def _owner(folder: Path) -> dict[str, str] | None:
    """The machine whose process made a hidden folder; None if it is not known."""
    try:
        owner = json.loads((folder / _OWNER).read_text())
        return {"host": str(owner["host"]), "boot": str(owner["boot"])}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _is_here(owner: dict[str, str]) -> bool:
    here = _here()
    return owner["host"] == here["host"] or bool(here["boot"] and owner["boot"] == here["boot"])


def tidy(root: Path) -> None:
    """Remove what is left beside a finished dataset, of a process that was killed as soon as it had published it."""
    folder = _hidden(root.absolute())
    if not folder.is_dir():
        return
    if (folder / PLAN).exists() or _owner(folder) is not None or {path.name for path in folder.iterdir()} <= {_LOCK}:
        with contextlib.suppress(Timeout), FileLock(folder / _LOCK, timeout=0):  # else it is about to do so itself
            _remove_hidden(folder)


def publish(made: Path, root: Path) -> None:
    """Move a dataset that is complete to where it is wanted.

    Raises:
        CEIError: something is there now.
    """
    if os.path.lexists(root):
        raise CEIError(f"{root} came into being meanwhile; choose another folder.")
    made.rename(root)


def remove(path: Path) -> None:
    """A file or folder, if it is there."""
    shutil.rmtree(path, ignore_errors=True) if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)


@contextlib.contextmanager
def temporary_folder(within: Path | None = None) -> Iterator[Path]:
    """A folder that is gone when the block ends, or the command is made to."""
    with signals.held():
        folder = Path(tempfile.mkdtemp(prefix=".", dir=within))
        token = signals.begin(lambda: shutil.rmtree(folder, ignore_errors=True))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        signals.end(token)


def _hidden(root: Path) -> Path:
    return root.parent / f".{root.name}.partial"
