"""Calls in threads, one a core, with results in order: what takes long (compiled kernels, decoding, thinning) needs no GIL."""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor


def ordered_map[Item, Result](call: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    """Results of `call` for each item, in their order.

    Memory holds a few results more than there are workers, however many items there are.
    """
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(call, item))
                if len(waiting) > 2 * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def in_background[Result](call: Callable[[], Result]) -> Callable[[], Result]:
    """Begin a call in a thread that nothing waits for at the end; what this returns waits for its result, or raises what it raises."""
    future: Future[Result] = Future()

    def run() -> None:
        try:
            future.set_result(call())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future.result
