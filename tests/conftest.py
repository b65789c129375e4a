"""What all tests share."""

import contextlib
import ctypes
import gc
import signal
from collections.abc import Iterator

import pytest

# Shells and nohup have what they start in the background ignore these, and it would be so for every process that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="module", autouse=True)
def _memory_is_given_back() -> Iterator[None]:
    """A worker that has run many modules holds what the last one needs: glibc keeps what was freed, half a gigabyte and more."""
    yield
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # no glibc
        ctypes.CDLL("libc.so.6").malloc_trim(0)
