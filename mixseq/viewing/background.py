"""Background threads of an object, ended when it is closed, and queues of jobs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from threading import Condition, Thread
from traceback import print_exception
from typing import Generic, Self, TypeVar

from mixseq.errors import MixseqError, MixseqWarning

Job = TypeVar("Job")


class Background:
    """Runs work on threads of its own until it is closed, at the latest by the end of a ``with`` block."""

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
        """End the threads after their current work."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()


class Jobs(Background, Generic[Job]):
    """Runs jobs in order until it is closed."""

    def __init__(self, failed: Callable[[str, Exception], None], jobs: Iterable[Job] = ()) -> None:
        self._failed = failed
        self._jobs = deque(jobs)
        super().__init__(self._work)

    def _do(self, job: Job) -> None:
        """Run a job, and report its failure."""
        raise NotImplementedError

    def _add(self, job: Job, needless: Callable[[Job], bool]) -> None:
        """Add a job to the queue, and drop the needless ones before it."""
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
