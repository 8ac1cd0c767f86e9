"""Processes of this machine that run long tasks, one at a time each; the only executor that survives crashes.

A process serves many tasks, since imports and compiled code take seconds to load. A task whose process died is run once
more at the end, alone, as the system may have ended it for want of memory. Ctrl-C reaches only the parent, which ends
its processes; they also end if the parent dies.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
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
    """Processes that are started when they are needed; made by `process_pool`."""

    def __init__(self, process_count: int, threads: int) -> None:
        self._process_count, self._threads = process_count, threads
        self._workers: list[_Worker] = []

    def as_completed(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item]
    ) -> Iterator[tuple[Item, Callable[[], Result]]]:
        """Yield every item when it is done, in any order, and a function that returns or raises its result."""
        suspects = []
        for item, answer in self._run(function, shared, items, self._process_count):
            if isinstance(answer, int):
                suspects.append(item)
            else:
                yield item, partial(_result, answer)
        for item, answer in self._run(function, shared, suspects, 1):
            yield item, partial(_result, answer)

    def _run(
        self, function: Callable[[Shared, Item], Result], shared: Shared, items: Iterable[Item], max_busy: int
    ) -> Iterator[tuple[Item, Any]]:
        """Yield items when they are done, with (result, error), or the exit code of a process that died."""
        remaining = iter(items)
        busy: dict[Connection, tuple[_Worker, Item]] = {}
        while True:
            for item in islice(remaining, max_busy - len(busy)):
                worker = self._idle_worker(busy)
                with suppress(OSError):  # a process that died idle is noticed below
                    worker.connection.send((function, shared, item))
                busy[worker.connection] = worker, item
            if not busy:
                return
            for connection in wait(list(busy)):
                worker, item = busy.pop(connection)  # type: ignore[call-overload]
                answer = worker.receive()
                if isinstance(answer, int):
                    self._workers.remove(worker)
                yield item, answer

    def _idle_worker(self, busy: dict[Connection, tuple[_Worker, Item]]) -> _Worker:
        for worker in self._workers:
            if worker.connection not in busy:
                return worker
        self._workers.append(_Worker(self._threads))
        return self._workers[-1]

    def close(self) -> None:
        """End all processes, also those at work."""
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
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

    def receive(self) -> tuple[Any, Exception | None] | int:
        """Return the answer to the last task, or the exit code if the process died."""
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
    with signals_as_exceptions(), suppress(EOFError, OSError):
        while True:
            function, shared, item = connection.recv()
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
        raise GivenUpError(
            f"its process was ended twice{reason}, at last while nothing else was running; it may need more memory "
            "than is free"
        )
    value, error = answer
    if error is not None:
        raise error
    return value
