"""Executors: parallel map over many items, with ordered results that do not depend on the number of threads.

All frame-wise work goes through an *executor*: a function of a shared object (a model, a space) and an item (a block of
frames). The caller chooses the caller's thread, several threads or the workers of a cluster; the same item has the same
result on each. So linear algebra is limited to one thread (`one_blas_thread`): splitting a matrix product over threads
changes the order of sums, and with it the last bits. Small products, which dominate here, would get slower, too.

Sequential work, such as a stream of bits, can run beside other work: `InTurn`.
"""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import lru_cache
from threading import Lock
from typing import Any, Protocol, TypeVar

from mixseq.errors import MixseqError, SettingsError

_lock = Lock()
_users = 0
_limit = ExitStack()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS and LAPACK of the process to one thread, from the first entry to the last exit on any thread."""
    global _users
    with _lock:
        if _users == 0:
            _limit.enter_context(_one_thread())
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if _users == 0:
                _limit.pop_all().close()


def _renew_lock() -> None:
    """Replace the lock in a forked process, where a missing thread may hold it."""
    global _lock
    _lock = Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)


def _one_thread() -> AbstractContextManager[object]:
    limits: AbstractContextManager[object] = _controller(len(sys.modules)).limit(limits=1, user_api="blas")
    return limits


@lru_cache(maxsize=1)
def _controller(modules: int) -> Any:
    """Find the libraries, which takes milliseconds; again only if modules were loaded since."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


_AHEAD = 4
"""Largest number of pieces of work that wait for `InTurn`, to bound memory."""

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Applies ``function(shared, item)`` to every item, and yields the results in the order of the items.

    Items are consumed lazily, so long sequences are never in memory as a whole. `function` is a plain function of a
    module and `shared` can be pickled, so that both can be sent to another machine.
    """

    def __call__(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        """Yield the results in the order of the items."""


def serially(
    function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
) -> Iterator[Result]:
    """Apply the function in the caller's thread."""
    for item in items:
        with one_blas_thread():
            result = function(shared, item)
        yield result


def on_threads(count: int | None = None) -> Executor:
    """Return an executor on `count` threads, by default `thread_count`."""
    threads = thread_count() if count is None else count
    if threads == 1:
        return serially

    def work(
        function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        with one_blas_thread(), ThreadPoolExecutor(threads) as pool:
            ahead: deque[Future[Result]] = deque()
            process = os.getpid()
            try:
                for item in items:
                    ahead.append(pool.submit(function, shared, item))
                    if len(ahead) > threads:  # one waits for the first thread that is done
                        yield ahead.popleft().result()
                        _check_process(process)
                while ahead:
                    yield ahead.popleft().result()
                    _check_process(process)
            finally:
                for future in ahead:
                    future.cancel()

    return work


def on_two_threads() -> Executor:
    """Return an executor on at most two threads, for items whose memory grows with the whole data."""
    return on_threads(min(2, thread_count()))


class InTurn:
    """One thread that runs pieces of work in order; the caller's if `thread_count` is 1."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1) if thread_count() > 1 else None
        self._waiting: deque[Future[None]] = deque()

    def take(self, work: Callable[[], None], large: bool = True) -> None:
        """Run a piece of work after those given before; in the caller's thread if it is not `large`."""
        if self._pool is None or not large:
            self.wait()
            work()
            return
        if len(self._waiting) >= _AHEAD:
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(work))

    def wait(self) -> None:
        """Wait for all work; its errors are raised here, or by the next `take`."""
        while self._waiting:
            self._waiting.popleft().result()


def _check_process(process: int) -> None:
    """Raise MixseqError in a forked process, which lacks the threads."""
    if os.getpid() != process:
        raise MixseqError("this iteration began before the process was forked; begin another one here")


def thread_count() -> int:
    """Return the number of threads to use: ``MIXSEQ_THREADS``, by default the cores available to this process."""
    wanted = os.environ.get("MIXSEQ_THREADS")
    if wanted:
        if not (wanted.isdigit() and int(wanted) > 0):
            raise SettingsError(f"MIXSEQ_THREADS is {wanted!r}; a whole number from 1 on is expected")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
