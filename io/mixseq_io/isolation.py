"""Readers in a process of their own, for formats that are parsed by C++ libraries.

Damaged files can make these libraries crash, hang, or take all memory, which cannot be caught in the same process.
Readers run in a reused worker (`mixseq_io.worker`), a second Python with limits on memory (`mixseq_io.files`) and on
time per answer; its death is reported as an error of the file. ``MIXSEQ_READER_SECONDS`` sets the limit of time: by
default 120 s of processor time, and four times that by the clock.

Workers are started on demand and reused, one for each open file. Above `MAX_WORKERS` files, the least recently used
one gives up its worker; at its next request it is opened again, and iterations continue where they were.
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
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.files import format_gigabytes, max_memory
from mixseq_io.reader import SequenceReader, warn
from mixseq_io.text.labels import Markings

MAX_WORKERS = 8
"""Largest number of files with workers at a time, unless more threads read files."""

_MOST_IDLE = 2


class OpenFile:
    """File that is open in a worker."""

    def __init__(self, path: Path, reader: str, options: dict[str, Any]) -> None:
        self.path = path
        self.worker: Worker | None = None
        self.asked = 0
        self._question = ("open", reader, str(path), options, str(Path.cwd()), max_memory())
        self._signature = _signature(path)
        self._times = 0  # that it was opened
        self._numbers = count()
        self.lock = threading.RLock()
        with self.lock:
            self.opened = self._open()
        _files.add(self)

    def ask(self, *question: Any) -> Any:
        """Return the answer to a request; see `mixseq_io.worker`."""
        with self.lock:
            return self._ready().ask(self.path, *question)

    def iterate(self, what: str, size: int) -> Iterator[Any]:
        """Yield the blocks of a worker's iteration."""
        number, done, times = next(self._numbers), 0, 0
        while True:
            with self.lock:
                worker = self._ready()
                if times != self._times:
                    worker.ask(self.path, "iterate", number, what, size, done, again=done > 0)
                    times = self._times
                block = worker.ask(self.path, "next", number)
            if block is None:
                return
            yield block
            done += 1

    def close(self) -> None:
        """Close the file and release its worker."""
        with self.lock:
            worker, self.worker = self.worker, None
        if worker is not None:
            release_worker(worker)

    def give_up(self) -> bool:
        """Release the worker if it is idle; return whether it was released."""
        if not self.lock.acquire(blocking=False):
            return False
        try:
            held = self.worker is not None
            self.close()
        finally:
            self.lock.release()
        return held

    def _ready(self) -> Worker:
        if self.worker is None:
            if _signature(self.path) != self._signature:
                raise FormatError(f"{self.path} has changed since it was opened; open it again")
            self._open()
        assert self.worker is not None
        self.asked = next(_questions)
        return self.worker

    def _open(self) -> Any:
        _make_room()
        self.worker = acquire_worker()
        try:
            answer = self.worker.ask(self.path, *self._question, again=self._times > 0)
        except BaseException:
            self.close()
            raise
        self._times += 1
        self.asked = next(_questions)
        return answer


class Worker:
    """Child process that answers one request at a time."""

    def __init__(self) -> None:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "mixseq_io.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # where C++ libraries grumble; their reports come with the answers
            env=environment,
        )
        self._stdin: Any = self._process.stdin
        self._stdout: Any = self._process.stdout
        # Whoever drops a reader without closing it leaves no process; without locks, which the same thread may hold.
        finalize(self, _end, self._process).atexit = False
        self._lock = threading.Lock()

    def ask(
        self,
        path: Path,
        *question: Any,
        again: bool = False,
        meanwhile: Callable[[], object] | None = None,
    ) -> Any:
        """Return the answer to a request about a file; raise its error, and repeat its warnings unless asked `again`.

        `meanwhile` is called before waiting for the answer.
        """
        try:
            with self._lock:
                pickle.dump(question, self._stdin)
                self._stdin.flush()
                if meanwhile is not None:
                    meanwhile()
                answer, error, warnings = pickle.load(self._stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise FormatError(self._obituary(path)) from None
        except BaseException:
            # Ctrl-C: the answer that is on its way must not be taken for that to another question.
            self._process.kill()
            raise
        for message in () if again else warnings:
            warn(message)
        if error is not None:
            raise error
        return answer

    def close(self) -> None:
        """End the process."""
        with suppress(OSError):
            self._stdin.close()
        self._stdout.close()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def leave(self) -> None:
        """Close the pipes in a forked process, so that the worker ends with its last owner."""
        nowhere = os.open(os.devnull, os.O_RDWR)
        for pipe in (self._stdin, self._stdout):
            if not pipe.closed:
                os.dup2(nowhere, pipe.fileno(), inheritable=False)
        os.close(nowhere)

    @property
    def alive(self) -> bool:
        """Whether it can answer requests."""
        return self._process.poll() is None

    def _obituary(self, path: Path) -> str:
        try:
            code = self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        if -code in (getattr(signal, name, None) for name in ("SIGPROF", "SIGALRM")):
            return (
                f"{path}: reading takes too long; it is damaged, or MIXSEQ_READER_SECONDS, the limit of time, must be "
                "raised"
            )
        return (
            f"{path}: the library that reads it crashed; it is damaged, export it again (or it needs more than "
            f"{format_gigabytes(max_memory())} of memory: --max-memory)"
        )


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and close its pipes."""
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()


_files: WeakSet[OpenFile] = WeakSet()
_questions = count(1)
idle_workers: list[Worker] = []
_of_parent: list[Worker] = []
_lock = threading.Lock()


def acquire_worker() -> Worker:
    """Return a worker without a file, a new one if none is idle."""
    with _lock:
        while idle_workers:
            worker = idle_workers.pop()
            if worker.alive:
                return worker
            worker.close()
    return Worker()


def release_worker(worker: Worker) -> None:
    """Keep a worker for the next file if it is alive and few are idle; else end it."""
    with suppress(FormatError):
        if worker.alive:
            worker.ask(Path(), "close")
    with _lock:
        if worker.alive and len(idle_workers) < _MOST_IDLE:
            idle_workers.append(worker)
            return
    worker.close()


def _make_room() -> None:
    """Release the least recently used file's worker if there are too many."""
    held = sorted((file for file in list(_files) if file.worker is not None), key=lambda file: file.asked)
    many = len(held) - MAX_WORKERS + 1
    for file in held:
        if many > 0:
            many -= file.give_up()


def _signature(path: Path) -> tuple[int, int, int] | None:
    """Return a file's identity: inode, size and modification time in ns; None if it does not exist."""
    try:
        state = path.stat()
    except OSError:
        return None
    return state.st_ino, state.st_size, state.st_mtime_ns


def _leave_to_parent() -> None:
    """Drop inherited workers in a forked process, since answers at a shared pipe would be mixed up."""
    global _lock
    _lock = threading.Lock()  # a thread that is not there may hold the other one
    _of_parent.extend(idle_workers)
    idle_workers.clear()
    for file in list(_files):
        if file.worker is not None:
            _of_parent.append(file.worker)
        file.worker, file.lock = None, threading.RLock()
    for worker in _of_parent:
        worker.leave()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_to_parent)


@atexit.register
def close_idle_workers() -> None:
    """End all idle workers."""
    while idle_workers:
        idle_workers.pop().close()


def open_isolated(reader: str, path: Path, options: dict[str, Any]) -> SequenceReader:
    """Open a file in a worker, or in this process where none can be started."""
    if not can_isolate():
        reader_here: SequenceReader = import_function(reader)(path, **options)
        return reader_here
    with ExitStack() as resources:
        file = OpenFile(path, reader, options)
        resources.callback(file.close)
        header, moving = file.opened
        return _IsolatedReader(path, _frozen(header), file, resources.pop_all(), moving)


def call_isolated(
    function: str, path: Path, *arguments: Any, meanwhile: Callable[[], object] | None = None
) -> Any:
    """Call a function of a file in a worker and return its value; arguments and errors as in `open_isolated`."""
    if not can_isolate():
        return import_function(function)(path, *arguments)
    worker = acquire_worker()
    try:
        question = "call", function, str(path), arguments, str(Path.cwd()), max_memory()
        return worker.ask(path, *question, meanwhile=meanwhile)
    finally:
        release_worker(worker)


time_limiters: list[Callable[[float], None]] = []
"""Functions that limit time in this process, if it is a worker."""


def limit_time(share: float) -> None:
    """Restart the clock of an answer with a share of the time limit; does nothing outside of a worker."""
    for start in time_limiters:
        start(share)


def import_function(reference: str) -> Callable[..., Any]:
    """Return the function named ``"module:function"`` or ``"module:object.method"``."""
    module, function = reference.split(":")
    found: Callable[..., Any] = attrgetter(function)(import_module(module))
    return found


def can_isolate() -> bool:
    """Whether a second Python can be started; applications that embed Python have no executable for it."""
    return "python" in Path(sys.executable or "").name.lower()


class _IsolatedReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, file: OpenFile, resources: ExitStack, moving: bool
    ) -> None:
        super().__init__(path, header, resources, moving)
        self._file = file

    def markings(self) -> Markings:
        """Return the sets of polygons and the joints of the mesh."""
        self._check_open()
        found: Markings = self._file.ask("markings")
        return found

    def _check_process(self) -> None:
        """Do nothing: a forked process opens the file again, in a worker of its own."""

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        return self._file.iterate(what, size)


def _frozen(header: SequenceHeader) -> SequenceHeader:
    """Return a header received from a worker with read-only arrays."""
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
