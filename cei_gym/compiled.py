"""`njit` for everything here that is compiled, with a cache that never outlives the code it was compiled from.

numba's own cache looks at the file of the function that is called, and at its time and size alone. Functions that it calls are compiled into it: when
one in another file changes, or a package is upgraded whose files all have one date, the old code runs on without a word.
"""

import contextlib
import fcntl
import hashlib
from pathlib import Path

from numba import njit

__all__ = ["forget_stale", "njit"]

_STAMP = "compiled-from.sha256"


def forget_stale(package: Path) -> bool:
    """Remove what numba has cached in a package's folders, if any of its sources has changed since.

    Args:
        package: folder of the package.

    Returns:
        Whether anything was removed. A package that cannot be written to is left alone: numba then caches elsewhere, by each file's path.
    """
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    stamp, removed = package / "__pycache__" / _STAMP, False
    with contextlib.suppress(OSError):
        stamp.parent.mkdir(exist_ok=True)
        # One process forgets, before any that waits here compiles: what it had just saved would be taken from under it.
        with stamp.open("a+") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            file.seek(0)
            if file.read() == digest.hexdigest():
                return False
            for cached in [*package.rglob("__pycache__/*.nbi"), *package.rglob("__pycache__/*.nbc")]:
                cached.unlink(missing_ok=True)
                removed = True
            file.truncate(0)
            file.write(digest.hexdigest())
    return removed


forget_stale(Path(__file__).parent)
