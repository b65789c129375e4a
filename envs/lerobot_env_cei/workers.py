"""Processes that start in seconds."""

import multiprocessing
import sys
from collections.abc import Generator
from contextlib import contextmanager

PRELOADED = ["cei_envs.rollout", "cei_envs.environment", "cei_envs.mounted"]


@contextmanager
def quick_start() -> Generator[None]:
    """Within, new processes import what environments need, once, and not the program that starts them.

    `multiprocessing` would import `lerobot-eval`, and with it all of LeRobot, in which nothing is for them.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    main = sys.modules["__main__"]
    hidden = {name: main.__dict__.pop(name) for name in ("__file__", "__spec__") if name in main.__dict__}
    main.__spec__ = None
    try:
        yield
    finally:
        main.__dict__.update(hidden)
