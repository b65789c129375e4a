"""Files that commands write, by one rule.

Results (JSON, joint maps, the picture of `cei-pads`, pages) are replaced only where `--overwrite` says so. Other pictures, videos and recordings can
be made again, so they are replaced; but only by their like: whatever is there that is no plain file of that kind, nothing replaces. Folders are made where they are
missing. No file goes into a dataset's folder. A file appears whole or not at all, and what was there before stays until then.
"""

import contextlib
import os
import socket
import stat
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path

from cei_converters import signals
from cei_converters.dataset.place import check_parent, dataset_around, inside_new
from cei_gym.errors import CEIError, one_line

_NAME_BYTES = 64  # of each part of a hidden file's name, which must not be too long


@dataclass(frozen=True)
class Kind:
    """A kind of files.

    Attributes:
        name: what it is called.
        suffixes: what their names may end in; none for whatever.
        begins: what they may begin with, `at` bytes from their start.
        made_again: whether they can be, so that they are replaced.
    """

    name: str
    suffixes: tuple[str, ...] = ()
    begins: tuple[bytes, ...] = ()
    at: int = 0
    made_again: bool = False

    def is_like(self, path: Path) -> bool:
        """Whether a file is of this kind, or empty."""
        with path.open("rb") as file:
            head = file.read(self.at + 16)
        return not head or not self.begins or head[self.at :].startswith(self.begins)


JSON = Kind("JSON file", begins=(b"{",))
JOINT_MAP = Kind("YAML file", (".yaml", ".yml"))
PICTURE = Kind("PNG picture", (".png",), (b"\x89PNG\r\n\x1a\n",), made_again=True)
ASKED_PICTURE = replace(PICTURE, made_again=False)
"""One that is all that a command is asked for, so that it is a result."""
VIDEO = Kind("MP4 video", (".mp4",), (b"ftyp",), at=4, made_again=True)
PAGE = Kind("HTML page", (".html", ".htm"), (b"<!doctype html", b"<!DOCTYPE html"))
RECORDING = Kind("rerun recording", (".rrd",), (b"RRF", b"RRIO"), made_again=True)


class Outputs:
    """The files that one command is asked to write, all checked before its work.

    Args:
        overwrite: whether results replace what is there.
        dataset: folder of the dataset that the command makes, which files must not go into either.
    """

    def __init__(self, overwrite: bool = False, dataset: Path | None = None) -> None:
        self._overwrite, self._dataset = overwrite, dataset
        self._options: dict[Path, str] = {}

    def file(self, option: str, path: Path | str | None, kind: Kind) -> "Output | None":
        """One of them; None if it is not asked for.

        Args:
            option: that names it.
            path: of the file.
            kind: what it will be.

        Raises:
            CEIError: it is called otherwise, cannot be made there, or must not replace what is.
        """
        if path is None:
            return None
        file, what = Path(path), f"{option}={path}"
        if kind.suffixes and file.suffix.lower() not in kind.suffixes:
            raise CEIError(f"{what} should end in {' or '.join(kind.suffixes)}.")
        try:
            there = self._there(what, file, kind)
            where = file.parent.resolve() / file.name
            if (other := self._options.setdefault(where, option)) != option:
                raise CEIError(f"{what} is the file of {other}, too; choose another.")
            if self._dataset is not None and inside_new(self._dataset, where):
                raise CEIError(
                    f"{what} is inside the dataset that is to be made, {self._dataset}; choose another place."
                )
            if (around := dataset_around(where)) is not None:
                raise CEIError(f"{what} is inside the dataset {around}; choose a place outside of it.")
            check_parent(where, what)
        except (OSError, RuntimeError) as error:  # a loop of links, a name that is too long
            raise CEIError(f"{what} cannot be written: {one_line(error)}.") from error
        return Output(file, replaces=there or kind.made_again)

    def _there(self, what: str, file: Path, kind: Kind) -> bool:
        """Whether there is a file already, which may be replaced."""
        try:
            mode = file.lstat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            return False
        if not stat.S_ISREG(mode):
            kinds = {stat.S_IFLNK: "a link", stat.S_IFDIR: "a folder"}
            raise CEIError(
                f"{what} is {kinds.get(stat.S_IFMT(mode), 'no plain file')}, which nothing replaces; choose another."
            )
        if not (kind.made_again or self._overwrite):
            raise CEIError(
                f"{what} already exists; choose another file, remove it first, or replace it with --overwrite."
            )
        if not kind.is_like(file):
            raise CEIError(f"{what} is there and is no {kind.name}, so it is not replaced; choose another file.")
        if not os.access(file, os.W_OK):
            raise CEIError(f"{what} is there and must not be written to; choose another file.")
        return True


@dataclass(frozen=True)
class Output:
    """A file to write.

    Attributes:
        path: of it.
        replaces: whether what is there when it is whole may be replaced.
    """

    path: Path
    replaces: bool = False

    def __str__(self) -> str:
        return str(self.path)

    @contextlib.contextmanager
    def whole(self) -> Generator[Path]:
        """A hidden sibling to write to: it becomes the file when the block ends well, and is removed if it does not.

        Raises:
            CEIError: there is a file by now.
        """
        start = os.fsdecode(os.fsencode(self.path.name)[:_NAME_BYTES])
        partial = self.path.with_name(f".{start}.{socket.gethostname()[:_NAME_BYTES]}.{os.getpid()}.partial")
        folders = [folder for folder in self.path.parents if not folder.exists()]

        def tidy() -> None:
            partial.unlink(missing_ok=True)
            for folder in folders:
                with contextlib.suppress(OSError):  # not empty: the file is in it
                    folder.rmdir()

        with signals.unfinished(tidy):
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                _sweep(partial)
                yield partial
                _settle(partial)
                if self.replaces:
                    partial.replace(self.path)
                else:
                    _publish(partial, self.path)
            finally:
                tidy()


def whole(path: Path) -> contextlib.AbstractContextManager[Path]:
    """As `Output.whole`, of a picture, video or recording."""
    return Output(path, replaces=True).whole()


def _settle(path: Path) -> None:
    """Have a file's content on the disk before its name: a power cut would else leave an empty one."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _publish(partial: Path, path: Path) -> None:
    try:
        path.hardlink_to(partial)  # which fails where there is a file, as renaming does not
    except FileExistsError:
        raise CEIError(f"{path} came into being meanwhile; choose another file.") from None
    except OSError:  # a file system without hard links
        if os.path.lexists(path):
            raise CEIError(f"{path} came into being meanwhile; choose another file.") from None
        partial.rename(path)


def _sweep(partial: Path) -> None:
    """Remove what killed processes of this machine left of the same file."""
    stem = partial.name.removesuffix(f"{os.getpid()}.partial")
    for left in partial.parent.iterdir():
        pid = left.name.removeprefix(stem).removesuffix(".partial")
        if left.name.startswith(stem) and pid.isdecimal() and left.name.endswith(".partial"):
            try:
                os.kill(int(pid), 0)
            except ProcessLookupError:
                left.unlink(missing_ok=True)
            except OSError:  # alive, and somebody else's
                continue
