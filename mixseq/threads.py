"""One thread for linear algebra, so that results do not depend on the number of threads.

A library that splits a matrix product over threads adds numbers in another order, and the last bits change; small
products, of which we have many, get slower on top.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import lru_cache
from threading import Lock
from typing import Any

_lock = Lock()
_users = 0
_limit = ExitStack()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Enter a context in which BLAS and LAPACK use one thread.

    The limit holds for the whole process. It is set by the first who enters and lifted by the last who leaves,
    whatever threads they are on.
    """
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
    """Replace the lock in a forked process, where a thread that is not there may hold it."""
    global _lock
    _lock = Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)


def _one_thread() -> AbstractContextManager[object]:
    limits: AbstractContextManager[object] = _controller(len(sys.modules)).limit(limits=1, user_api="blas")
    return limits


@lru_cache(maxsize=1)
def _controller(modules: int) -> Any:
    """Find the libraries, which takes milliseconds: again only when modules, and perhaps libraries, were loaded."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
