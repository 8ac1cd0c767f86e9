"""Run readers in a worker process, for formats that are parsed by C++ libraries.

A damaged file can make these libraries crash, hang, or allocate all memory, which cannot be caught in the same process.
A worker (`mixseq_io.worker`) is a second Python process with limits on memory (`mixseq_io.files`) and on time per
request: ``MIXSEQ_READER_SECONDS`` of processor time, by default 120, and four times that by the clock. If it dies, the
file is reported as damaged. Workers serve one open file at a time, and are reused. A forked process starts its own.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from importlib import import_module
from itertools import count
from operator import attrgetter
from pathlib import Path
from typing import Any
from weakref import WeakSet, finalize

from mixseq.errors import FormatError
from mixseq.runtime.interrupts import blocked_interrupts
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray
from mixseq_io.files import format_gigabytes, max_memory
from mixseq_io.reader import SequenceReader, warn
from mixseq_io.text.labels import Markings

_MAX_IDLE_WORKERS = 2
_EXIT_SECONDS = 5.0


class WorkerProcess:
    """Worker process that serves one request at a time."""

    def __init__(self) -> None:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with blocked_interrupts():
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "mixseq_io.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,  # C++ libraries print to stderr; errors and warnings arrive with answers
                env=environment,
            )
        self._stdin: Any = self._process.stdin
        self._stdout: Any = self._process.stdout
        # End the process if its reader is dropped unclosed. No locks are used, since this thread may hold them.
        finalize(self, _kill, self._process).atexit = False
        self._lock = threading.Lock()
        _all_workers.add(self)

    def request(self, path: Path, *request: Any, meanwhile: Callable[[], object] | None = None) -> Any:
        """Send a request, call `meanwhile`, and return the value of the answer or raise its error."""
        try:
            with self._lock:
                pickle.dump(request, self._stdin)
                self._stdin.flush()
                if meanwhile is not None:
                    meanwhile()
                value, error, warnings = pickle.load(self._stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise FormatError(self._explain_death(path)) from None
        except BaseException:
            # After Ctrl-C, the next request would otherwise receive the pending answer.
            self._process.kill()
            raise
        for message in warnings:
            warn(message)
        if error is not None:
            raise error
        return value

    def close(self) -> None:
        """End the process."""
        with suppress(OSError):
            self._stdin.close()
        self._stdout.close()
        self._wait()

    def detach(self) -> None:
        """Close the pipes in a forked process, so that only the parent keeps the worker alive."""
        null_device = os.open(os.devnull, os.O_RDWR)
        for pipe in (self._stdin, self._stdout):
            if not pipe.closed:
                os.dup2(null_device, pipe.fileno(), inheritable=False)
        os.close(null_device)

    @property
    def is_alive(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    def _wait(self) -> int:
        """Wait for the end of the process, kill the process after a timeout, and return its exit code."""
        try:
            return self._process.wait(timeout=_EXIT_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _explain_death(self, path: Path) -> str:
        signal_number = -self._wait()
        cause = "the library that reads it crashed; the file is damaged, export it again"
        if signal_number in (getattr(signal, name, None) for name in ("SIGPROF", "SIGALRM")):
            cause = (
                "reading takes too long; the file is damaged, or the time limit, the environment variable "
                "MIXSEQ_READER_SECONDS, must be raised"
            )
        # Libraries that are short of memory can also wait forever for a thread that could not be started.
        return f"{path}: {cause} (or it needs more than {format_gigabytes(max_memory())} of memory: --max-memory)"


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and close its pipes."""
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()


_all_workers: WeakSet[WorkerProcess] = WeakSet()
_iteration_ids = count()  # unique among all files, since workers are reused
idle_workers: list[WorkerProcess] = []
_workers_of_parent: list[WorkerProcess] = []
_lock = threading.Lock()


def acquire_worker() -> WorkerProcess:
    """Return an idle worker, or start a worker if none is idle."""
    with _lock:
        while idle_workers:
            worker = idle_workers.pop()
            if worker.is_alive:
                return worker
            worker.close()
    return WorkerProcess()


def release_worker(worker: WorkerProcess) -> None:
    """Keep a worker for the next file if it is alive and few workers are idle; otherwise end the worker."""
    with suppress(FormatError):
        if worker.is_alive:
            worker.request(Path(), "close")
    with _lock:
        if worker.is_alive and len(idle_workers) < _MAX_IDLE_WORKERS:
            idle_workers.append(worker)
            return
    worker.close()


def _detach_workers() -> None:
    """Drop the inherited workers in a forked process, since two processes cannot share a pipe."""
    global _lock
    _lock = threading.Lock()  # a thread that was not forked may hold the inherited lock
    _workers_of_parent.extend(_all_workers)
    idle_workers.clear()
    for worker in _workers_of_parent:
        worker.detach()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_detach_workers)


@atexit.register
def close_idle_workers() -> None:
    """End all idle workers."""
    while idle_workers:
        idle_workers.pop().close()


def open_isolated(reader: str, path: Path, options: dict[str, Any]) -> SequenceReader:
    """Open a file with a reader ``"module:function"`` in a worker, or in this process if none can be started."""
    if not can_isolate():
        local_reader: SequenceReader = import_function(reader)(path, **options)
        return local_reader
    worker = acquire_worker()
    with ExitStack() as resources:
        resources.callback(release_worker, worker)
        answer = worker.request(path, "open", reader, str(path), options, str(Path.cwd()), max_memory())
        header, has_velocities, can_evaluate = answer
        return _IsolatedReader(path, _frozen(header), resources.pop_all(), has_velocities, can_evaluate, worker)


def call_isolated(function: str, path: Path, *arguments: Any, meanwhile: Callable[[], object] | None = None) -> Any:
    """Call ``"module:function"`` with a path in a worker, and return the result; call `meanwhile` while it runs."""
    if not can_isolate():
        return import_function(function)(path, *arguments)
    worker = acquire_worker()
    try:
        request = "call", function, str(path), arguments, str(Path.cwd()), max_memory()
        return worker.request(path, *request, meanwhile=meanwhile)
    finally:
        release_worker(worker)


time_limiters: list[Callable[[float], None]] = []
"""Functions that restart the time limit of this process; the list is empty outside of workers."""


def limit_time(fraction: float) -> None:
    """Restart the time limit of a request as a fraction of the full limit; do nothing outside of a worker."""
    for restart in time_limiters:
        restart(fraction)


def import_function(reference: str) -> Callable[..., Any]:
    """Import the function named ``"module:function"`` or ``"module:object.method"``."""
    module, function = reference.split(":")
    imported: Callable[..., Any] = attrgetter(function)(import_module(module))
    return imported


def can_isolate() -> bool:
    """Whether a second Python process can be started; applications that embed Python have no Python executable."""
    return "python" in Path(sys.executable or "").name.lower()


class _IsolatedReader(SequenceReader):
    def __init__(
        self,
        path: Path,
        header: SequenceHeader,
        resources: ExitStack,
        has_velocities: bool,
        can_evaluate: bool,
        worker: WorkerProcess,
    ) -> None:
        super().__init__(path, header, resources, has_velocities, can_evaluate)
        self._worker = worker

    def markings(self) -> Markings:
        """Return the face sets and skinning weights of the mesh."""
        self._check_open()
        markings: Markings = self._worker.request(self.path, "markings")
        return markings

    def _read(self, quantity: str, size: int) -> Iterator[FloatArray]:
        return self._iterate(quantity, size, None)

    def _evaluate(self, quantity: str, frames: Float, size: int) -> Iterator[FloatArray]:
        return self._iterate(quantity, size, frames)

    def _iterate(self, quantity: str, size: int, frames: Float | None) -> Iterator[FloatArray]:
        iteration = next(_iteration_ids)
        self._worker.request(self.path, "iterate", iteration, quantity, size, frames)
        while (block := self._worker.request(self.path, "next", iteration)) is not None:
            yield block


def _frozen(header: SequenceHeader) -> SequenceHeader:
    """Make the arrays of an unpickled header read-only."""
    surface = header.surface
    return replace(
        header,
        polygons=replace(header.polygons),
        surface=replace(
            surface,
            uvs=surface.uvs and replace(surface.uvs),
            colours=surface.colours and replace(surface.colours),
            face_sets=tuple(replace(face_set) for face_set in surface.face_sets),
        ),
    )
