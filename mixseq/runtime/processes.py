"""Processes of this machine that do one item of work at a time, and survive crashes.

A process serves many items, since imports and compiled code take seconds to load. An item whose process died is tried
once more, in a batch at the end and alone, as the system may have ended it for want of memory. Ctrl-C reaches only the
parent, which ends its processes; they also end if the parent dies.
"""

from __future__ import annotations

import atexit
import gc
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from itertools import islice
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from mixseq.errors import GivenUpError
from mixseq.runtime.interrupts import blocked_interrupts, signals_as_exceptions
from mixseq.runtime.parallel import environment, thread_variables

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

EXIT_SECONDS = 5.0
"""Time in which processes clean up before they are killed."""


class ProcessPool:
    """An `Executor` on processes that are started when they are needed; made by `process_pool`."""

    def __init__(self, process_count: int, threads: int) -> None:
        self._process_count, self._threads = process_count, threads
        self._workers: list[_Worker] = []

    def __call__(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[Result]:
        """Yield ``function(shared, item)`` in the order of the items; items are consumed when processes become free."""
        task = pickle.dumps((function, shared))
        done: dict[int, Any] = {}
        next_number = 0
        with closing(self._run(task, items, lambda: 2 * self._process_count - len(done))) as answers:
            for number, item, answer in answers:
                died = isinstance(answer, int)
                done[number] = next(self._run(task, [item], lambda: 1))[2] if died else answer
                while next_number in done:
                    yield _result(done.pop(next_number))
                    next_number += 1

    def as_completed(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[tuple[Item, Callable[[], Result]]]:
        """Yield every item when it is done, in any order, and a function that returns or raises its result."""
        task = pickle.dumps((function, shared))
        suspects = []
        for _, item, answer in self._run(task, items, lambda: self._process_count):
            if isinstance(answer, int):
                suspects.append(item)
            else:
                yield item, partial(_result, answer)
        for _, item, answer in self._run(task, suspects, lambda: 1):
            yield item, partial(_result, answer)

    def _run(
        self, task: bytes, items: Iterable[Item], max_busy: Callable[[], int]
    ) -> Generator[tuple[int, Item, Any], None, None]:
        """Yield numbers and items when they are done, with (result, error) or the exit code of a process that died."""
        remaining = enumerate(items)
        busy: dict[Connection, tuple[_Worker, int, Item]] = {}
        try:
            while True:
                free = min(max_busy(), self._process_count) - len(busy)
                for number, item in islice(remaining, max(free, 0)):
                    worker = self._idle_worker()
                    worker.send(task, item)
                    busy[worker.connection] = worker, number, item
                if not busy:
                    return
                for connection in wait(list(busy)):
                    worker, number, item = busy.pop(connection)  # type: ignore[call-overload]
                    answer = worker.receive()
                    if isinstance(answer, int):
                        self._workers.remove(worker)
                    yield number, item, answer
        finally:
            self._end([worker for worker, _, _ in busy.values()])

    def _idle_worker(self) -> _Worker:
        for worker in self._workers:
            if not worker.is_busy and worker.process.is_alive():
                return worker
        self._workers.append(_Worker(self._threads))
        return self._workers[-1]

    def close(self) -> None:
        """End all processes, also those at work."""
        self._end(list(self._workers))

    def _end(self, workers: list[_Worker]) -> None:
        for worker in workers:
            self._workers.remove(worker)
            worker.process.terminate()
        for worker in workers:
            worker.process.join(EXIT_SECONDS)
            worker.process.kill()
            worker.process.join()
            worker.connection.close()


@contextmanager
def process_pool(process_count: int, threads: int = 1) -> Iterator[ProcessPool]:
    """Return a pool of processes with this number of threads each, which end with the block."""
    pool = ProcessPool(process_count, threads)
    try:
        yield pool
    finally:
        pool.close()


class _Worker:
    def __init__(self, threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, remote = context.Pipe()
        self.process = context.Process(target=_serve, args=(remote,), daemon=True)
        with blocked_interrupts(), environment(**thread_variables(threads)):
            self.process.start()
        remote.close()
        self.is_busy = False
        self._task: bytes | None = None

    def send(self, task: bytes, item: object) -> None:
        """Send an item, and the pickled function and shared object if they are others than before."""
        with suppress(OSError):  # `receive` notices that the process has died
            self.connection.send((None if task is self._task else task, item))
        self._task, self.is_busy = task, True

    def receive(self) -> tuple[Any, Exception | None] | int:
        """Return the answer to the last item, or the exit code if the process died."""
        self.is_busy = False
        try:
            answer: tuple[Any, Exception | None] = self.connection.recv()
        except (EOFError, OSError):
            self.connection.close()
            self.process.join()
            return self.process.exitcode or 0
        return answer


def _serve(connection: Connection) -> None:
    """Run the tasks that arrive at a connection until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    atexit.register(gc.freeze)  # ends the process sooner, as in `mixseq.__main__`
    with signals_as_exceptions(), suppress(EOFError, OSError):
        while True:
            task, item = connection.recv()
            if task is not None:
                function, shared = pickle.loads(task)
            value, error = None, None
            try:
                value = function(shared, item)
            except Exception as raised:
                error = raised
            connection.send((value, error))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def _result(answer: tuple[Any, Exception | None] | int) -> Any:
    if isinstance(answer, int):
        reason = next((f" ({each.name})" for each in signal.Signals if each == -answer), f" (exit code {answer})")
        raise GivenUpError(f"its process was ended twice{reason}; it may need more memory than is free")
    value, error = answer
    if error is not None:
        raise error
    return value
