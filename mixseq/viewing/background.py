"""Threads of an object that work in the background as long as it is open."""

from __future__ import annotations

from collections.abc import Callable
from threading import Condition, Thread
from typing import Self


class Background:
    """Works on threads of its own until it is closed; closes at the end of a ``with`` block.

    Parameters
    ----------
    work : callable
        What each thread does. It waits for `_changed`, and returns once `_closed` is set.
    threads : int
        How many threads there are.
    """

    def __init__(self, work: Callable[[], None], threads: int = 1) -> None:
        self._closed = False
        self._changed = Condition()
        self._threads = [Thread(target=work, daemon=True) for _ in range(threads)]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads, after what they are at."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()
