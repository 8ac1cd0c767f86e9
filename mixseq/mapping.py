"""Work on many items at once: results come in order, and are the same whoever does it.

Everything that is done frame by frame goes through an *executor*: a function of something shared (a model, a
space) and of an item (a block of frames). What does the work, the caller's thread, several threads, or the workers
of a cluster, is chosen by the caller; the function knows nothing of it, and the same item has the same result.

Where each piece of work needs the one before, as in a stream of bits, it can still be done beside something else: that
is `InTurn`.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar

from mixseq.errors import MixseqError, SettingsError
from mixseq.threads import one_blas_thread

_AHEAD = 4
"""So many pieces of work wait for `InTurn` at most: what they hold stays small."""

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Applies ``function(shared, item)`` to every item, and yields the results in the order of the items.

    Items are taken as results are: a long sequence is never in memory as a whole. `function` is a plain function
    of a module and `shared` can be pickled, so that both can go to another machine.
    """

    def __call__(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        """Yield the results."""


def serially(
    function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
) -> Iterator[Result]:
    """Do the work in the caller's thread."""
    for item in items:
        with one_blas_thread():
            result = function(shared, item)
        yield result


def on_threads(count: int | None = None) -> Executor:
    """Return an executor that works on `count` threads; by default on `thread_count`.

    Examples
    --------
    >>> list(on_threads(2)(pow, 2, range(5)))
    [1, 2, 4, 8, 16]
    """
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
    """Return an executor that works on two threads, or on one if `thread_count` is 1.

    For work of which each piece takes memory in proportion to all of the data, not to the piece: on as many threads as
    there are cores it would take more memory on larger machines.
    """
    return on_threads(min(2, thread_count()))


class InTurn:
    """One thread, on which one piece of work after the other is done; the caller's if `thread_count` is 1.

    Examples
    --------
    >>> found, turns = [], InTurn()
    >>> for number in range(5):
    ...     turns.take(lambda number=number: found.append(number))
    >>> turns.wait()
    >>> found
    [0, 1, 2, 3, 4]
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1) if thread_count() > 1 else None
        self._waiting: deque[Future[None]] = deque()

    def take(self, work: Callable[[], None], large: bool = True) -> None:
        """Do a piece of work after those that were given before it; at once if it is not `large`."""
        if self._pool is None or not large:
            self.wait()
            work()
            return
        if len(self._waiting) >= _AHEAD:
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(work))

    def wait(self) -> None:
        """Return when all of it is done; an error of it is raised here, or when more is given."""
        while self._waiting:
            self._waiting.popleft().result()


def _check_process(process: int) -> None:
    """Refuse to wait for threads that a fork did not copy."""
    if os.getpid() != process:
        raise MixseqError("this iteration began before the process was forked; begin another one here")


def thread_count() -> int:
    """Return how many threads to use: ``MIXSEQ_THREADS``, else as many as this process has cores."""
    wanted = os.environ.get("MIXSEQ_THREADS")
    if wanted:
        if not (wanted.isdigit() and int(wanted) > 0):
            raise SettingsError(f"MIXSEQ_THREADS is {wanted!r}; a whole number from 1 on is expected")
        return int(wanted)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
