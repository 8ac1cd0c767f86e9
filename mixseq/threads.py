"""Limit of linear algebra to one thread, so that results do not depend on the number of threads.

Splitting a matrix product over threads changes the order of sums, and with it the last bits. Small products, which
dominate here, get slower.
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
