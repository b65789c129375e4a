"""What a command leaves behind: its result as JSON, and other files, whole or not at all."""

import contextlib
import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from cei_converters.dataset.metadata import plain
from cei_gym.errors import CEIError


def check_json_path(path: str | None) -> None:
    """Fail before the work, not after it, if the result could not be written."""
    if path is not None and not Path(path).absolute().parent.is_dir():
        raise CEIError(f"--json={path}: there is no folder {Path(path).parent}.")


def write_json(path: str | None, result: dict[str, Any], **long: Iterable[Any]) -> None:
    """Write a result in one go (a reader never sees half of it); nothing if no path is asked for.

    Args:
        path: of the file.
        result: JSON types, arrays and dataclasses; not empty.
        long: lists that come after it, by name, of which memory holds one item.
    """
    if path is None:
        return
    with whole(Path(path)) as partial, partial.open("w") as file:
        file.write(json.dumps(plain(result), indent=1, allow_nan=False).removesuffix("\n}"))
        for name, items in long.items():
            file.write(f",\n {json.dumps(name)}: [")
            for i, item in enumerate(items):
                file.write(("," if i else "") + "\n  " + json.dumps(plain(item), allow_nan=False))
            file.write("\n ]")
        file.write("\n}\n")


def check_new(option: str, path: str | None, suffix: str) -> Path | None:
    """The path of a file to make, None if none is asked for.

    Raises:
        CEIError: it exists, or ends in something else than the suffix.
    """
    if path is None:
        return None
    file = Path(path)
    if file.suffix != suffix:
        raise CEIError(f"{option}={path} should end in {suffix}.")
    if file.exists():
        raise CEIError(f"{option}={path} already exists; choose another file or remove it first.")
    return file


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A hidden sibling of `path` to write to: it becomes `path` when the block ends well, and is removed if it does not."""
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
