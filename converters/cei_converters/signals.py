"""A command ends when it is told to (Ctrl-C, SIGTERM, SIGHUP), at whatever moment, and leaves nothing unfinished behind.

An exception in the main thread is how work is given up, but it may meet a library that swallows it, or strike between the making of a
file and the `try` that removes it. So whatever is unfinished is also listed here: before it is made until it is whole or gone.

Only the standard library is imported: this is the first that a command does.
"""

import atexit
import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn

WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGHUP: "hung up"}
"""What a command says as it ends, on stderr; its exit code is 128 and the signal's number, as shells have it."""

PATIENCE_S = 3.0
"""How long giving up may take before the process ends without: an exception was swallowed, or a thread is waited for."""

_DEAF = os.path.join("llvmlite", "binding", "executionengine.py")  # noqa: PTH118  (a part of a path)
_AGAIN_S = 0.01


class _State:
    received: int | None = None  # the signal that ends the command
    held: int = 0
    waiting: bool = False  # whether it came while it had to wait
    owned: bool = False  # whether the process is the command's, to end at once
    over: int | None = None  # exit code, once the command has finished


_state = _State()
_unfinished: dict[object, Callable[[], object]] = {}


def own() -> None:
    """Take charge of the process's signals, for good. What was started to ignore one, as `nohup` does, goes on ignoring it."""
    _state.owned = True
    for number in WORDS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _on_signal)
    atexit.register(_ignore)


@contextlib.contextmanager
def heeded() -> Iterator[None]:
    """Raise KeyboardInterrupt in the block where a signal comes; in the main thread of a process that is not owned."""
    _state.received = None
    previous = {}
    if not _state.owned and threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):  # SIGINT does so by itself
            if signal.getsignal(number) != signal.SIG_IGN:
                previous[number] = signal.signal(number, _on_signal)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def received() -> int | None:
    """The signal that ends the command, if one has come."""
    return _state.received


def finished(code: int) -> None:
    """Say that the command has ended with an exit code, which no signal changes any more."""
    _state.over = code


@contextlib.contextmanager
def unfinished(tidy: Callable[[], object]) -> Iterator[None]:
    """Have `tidy` called if the command is made to end within the block. It may be called twice, and must not mind."""
    token = begin(tidy)
    try:
        yield
    finally:
        end(token)


def begin(tidy: Callable[[], object]) -> object:
    """As `unfinished`, until `end` is called with what this returns."""
    token = object()
    _unfinished[token] = tidy
    return token


def end(token: object) -> None:
    """See `begin`."""
    _unfinished.pop(token, None)


def tidy_up() -> None:
    """Remove what is unfinished, latest first, in a process that is owned. Signals wait meanwhile."""
    with held():
        while _unfinished and _state.owned:
            token = next(reversed(_unfinished))
            with contextlib.suppress(Exception):
                _unfinished[token]()
            end(token)  # not before: if this takes too long, `_leave` does it again


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Have signals wait for the end of the block. In threads they do so anyway: it is the main one that signals strike."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _state.held += 1
    try:
        yield
    finally:
        _state.held -= 1
        if _state.waiting and not _state.held:
            _state.waiting = False
            _give_up()


@contextlib.contextmanager
def spared() -> Iterator[None]:
    """Have processes that are started in the block never get a terminal's Ctrl-C, which goes to all of a command's: they end when it does."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def word(number: int) -> str:
    """What is said of a signal."""
    return WORDS.get(signal.Signals(number), "interrupted")


def _ignore() -> None:
    """Have signals change nothing any more. Python gives them back to the system as it ends, which would end what has succeeded as killed."""
    for number in WORDS:
        signal.signal(number, signal.SIG_IGN)


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _state.over is not None:
        os._exit(_state.over)
    if _state.received is not None:  # it is giving up already: a second Ctrl-C must not break that
        return
    _state.received = number
    _give_up_when_heard(number, frame)


def _give_up_when_heard(_number: int, frame: FrameType | None) -> None:
    """Give up, later where it has to wait, or where nobody would hear: what is raised in what numba's compiler calls back is printed, and lost."""
    if _state.over is not None:
        os._exit(_state.over)
    if _state.held:
        _state.waiting = True
        return
    while frame is not None:
        if frame.f_code.co_filename.endswith(_DEAF):
            signal.signal(signal.SIGALRM, _give_up_when_heard)
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        frame = frame.f_back
    _give_up()


def _give_up() -> NoReturn:
    if _state.owned:
        if not _unfinished:
            _leave()
        signal.signal(signal.SIGALRM, lambda *_: _leave())
        signal.setitimer(signal.ITIMER_REAL, PATIENCE_S)
    raise KeyboardInterrupt


def _leave() -> NoReturn:
    if _state.over is not None:
        os._exit(_state.over)
    tidy_up()
    number = _state.received or signal.SIGINT
    with contextlib.suppress(OSError):
        os.write(2, f"{word(number)}\n".encode())
    os._exit(128 + number)
