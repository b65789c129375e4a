"""What all tests share."""

import contextlib
import ctypes
import gc
import signal
from collections.abc import Iterator

import pytest

LONGEST = (
    "test_main_job",
    "test_signals",
    "test_resume",
    "test_lerobot_scripts",
    "test_benchmark_command",
    "test_benchmarks",
    "test_edited",
    "test_malformed",
    "test_policy_benchmark",
    "test_real_clouds",
    "test_envs",
    "test_provenance",
    "test_demo",
    "test_extras",
)
"""Files that take half a minute and more. They begin first, so that the processes that share the tests end together."""

# Shells and nohup have what they start in the background ignore these, and it would be so for every process that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    order = {name: i for i, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))


@pytest.fixture(scope="module", autouse=True)
def _memory_is_given_back() -> Iterator[None]:
    """A worker that has run many modules holds what the last one needs: glibc keeps what was freed, half a gigabyte and more."""
    yield
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # no glibc
        ctypes.CDLL("libc.so.6").malloc_trim(0)
