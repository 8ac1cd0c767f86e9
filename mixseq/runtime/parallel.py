"""Executors: parallel map over items, with ordered results that do not depend on the number of threads.

All frame-wise work goes through an *executor*, which applies a function to a shared object (a model, a space) and items
(blocks of frames). An executor uses the caller's thread, several threads or the workers of a cluster, with equal
results. So linear algebra is limited to one thread (`one_blas_thread`): splitting a matrix product over threads changes
the order of sums and thus the last bits. Small products, which dominate here, would also be slower.
"""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from threading import Lock
from typing import Any, Protocol, TypeVar

from mixseq.errors import MixseqError, SettingsError

_lock = Lock()
_user_count = 0
_blas_limit = ExitStack()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS and LAPACK of the process to one thread, from the first entry to the last exit on any thread."""
    global _user_count
    with _lock:
        if _user_count == 0:
            _blas_limit.enter_context(_blas_controller(len(sys.modules)).limit(limits=1, user_api="blas"))
        _user_count += 1
    try:
        yield
    finally:
        with _lock:
            _user_count -= 1
            if _user_count == 0:
                _blas_limit.pop_all().close()


def _renew_lock() -> None:
    """Replace the lock in a forked process, as a thread of the parent process may have held the lock."""
    global _lock
    _lock = Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)


@lru_cache(maxsize=1)
def _blas_controller(module_count: int) -> Any:
    """Find the BLAS libraries, which takes milliseconds; cached until more modules are imported."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


class Executor(Protocol):
    """Apply ``function(shared, item)`` to every item, and yield the results in the order of the items.

    Items are consumed lazily, so that long sequences are never in memory as a whole. `function` must be defined at
    module level and `shared` picklable, so that both can be sent to another machine.
    """

    def __call__(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        """Yield the results in the order of the items."""


def serial_executor(
    function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
) -> Iterator[Result]:
    """Apply the function in the caller's thread."""
    for item in items:
        with one_blas_thread():
            result = function(shared, item)
        yield result


def thread_executor(count: int | None = None) -> Executor:
    """Return an executor on `count` threads, by default `thread_count()`."""
    threads = thread_count() if count is None else count
    if threads == 1:
        return serial_executor

    def run(function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]) -> Iterator[Result]:
        with one_blas_thread(), ThreadPoolExecutor(threads) as pool:
            pending: deque[Future[Result]] = deque()
            process_id = os.getpid()
            try:
                for item in items:
                    pending.append(pool.submit(function, shared, item))
                    if len(pending) > threads:  # one extra item, for the first thread that becomes free
                        yield pending.popleft().result()
                        _check_process(process_id)
                while pending:
                    yield pending.popleft().result()
                    _check_process(process_id)
            finally:
                for future in pending:
                    future.cancel()

    return run


def two_thread_executor() -> Executor:
    """Return an executor on at most two threads, for items that need memory in proportion to all data."""
    return thread_executor(min(2, thread_count()))


def _check_process(process_id: int) -> None:
    """Raise MixseqError in a forked process, which has no copy of the threads."""
    if os.getpid() != process_id:
        raise MixseqError("the process was forked during this iteration; start a new iteration")


def thread_count() -> int:
    """Return the number of threads to use: ``MIXSEQ_THREADS``, by default the cores available to this process."""
    setting = os.environ.get("MIXSEQ_THREADS")
    if setting:
        if not (setting.isdigit() and int(setting) > 0):
            raise SettingsError(f"MIXSEQ_THREADS is {setting!r}; set it to a whole number of at least 1")
        return int(setting)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_variables(count: int) -> dict[str, str]:
    """Return environment variables that limit the libraries of a new process to a number of threads."""
    names = ("MIXSEQ_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    return dict.fromkeys(names, str(count))


@contextmanager
def environment(**variables: str) -> Iterator[None]:
    """Set environment variables inside the ``with`` block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
