"""Threads of an object that work in the background as long as it is open; jobs that one does after the other."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from threading import Condition, Thread
from traceback import print_exception
from typing import Generic, Self, TypeVar

from mixseq.errors import MixseqError, MixseqWarning

Job = TypeVar("Job")


class Background:
    """Works on threads of its own until it is closed; closes at the end of a ``with`` block."""

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


class Jobs(Background, Generic[Job]):
    """Does jobs one after the other, until it is closed."""

    def __init__(self, failed: Callable[[str, Exception], None], jobs: Iterable[Job] = ()) -> None:
        self._failed = failed
        self._jobs = deque(jobs)
        super().__init__(self._work)

    def _do(self, job: Job) -> None:
        """Do one, and tell what fails."""
        raise NotImplementedError

    def _add(self, job: Job, needless: Callable[[Job], bool]) -> None:
        """Do another one after those that wait; leave out those of them that are needless then."""
        with self._changed:
            self._jobs = deque(each for each in self._jobs if not needless(each))
            self._jobs.append(job)
            self._changed.notify_all()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._closed)
                if self._closed:
                    return
                job = self._jobs.popleft()
            self._do(job)

    def _fail(self, what: str, error: Exception) -> None:
        if not isinstance(error, MixseqError | MixseqWarning):  # a bug, but the work goes on
            print_exception(error)
        try:
            self._failed(what, error)
        except Exception as again:
            print_exception(again)
