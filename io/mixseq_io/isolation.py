"""Readers in a process of their own, for formats that are parsed by C++ libraries.

A damaged file can make such a library crash, hang, or ask for all memory; none of that can be caught where it
happens. So these readers run in a worker (`mixseq_io.worker`), a second Python with limits on its memory
(`mixseq_io.memory`) and on the time of each answer. When it dies, the file is to blame and the user gets an error as
from any other format. Workers are reused, because starting one takes half a second.

The limit of time can be raised by the environment variable ``MIXSEQ_READER_SECONDS`` (120 of processor time; four
times as long by the clock, for files that never answer).
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
from pathlib import Path
from typing import Any

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError
from mixseq.sequence import SequenceHeader
from mixseq_io.blocks import warn
from mixseq_io.labels.markings import Markings
from mixseq_io.memory import gigabytes, max_memory
from mixseq_io.reader import SequenceReader

_MOST_IDLE = 2


def open_isolated(reader: str, path: Path, options: dict[str, Any]) -> SequenceReader:
    """Open a file in a worker, or here where none can be started.

    Parameters
    ----------
    reader : str
        ``"module:function"`` that opens it.
    path : Path
        The file.
    options : dict
        The function's options.

    Raises
    ------
    MixseqError
        As the function.
    FormatError
        If the worker dies or exceeds its limits.
    """
    if not can_isolate():
        reader_here: SequenceReader = loaded(reader)(path, **options)
        return reader_here
    with ExitStack() as resources:
        worker = _hire()
        resources.callback(_dismiss, worker)
        header, moving = worker.ask(path, "open", reader, str(path), options, str(Path.cwd()), max_memory())
        return _IsolatedReader(path, _frozen(header), worker, resources.pop_all(), moving)


def call_isolated(function: str, path: Path, *arguments: Any) -> Any:
    """Call a function of a file in a worker and return its value; parameters and errors are those of `open_isolated`.

    Parameters
    ----------
    function : str
        ``"module:function"``; it takes the path and the arguments.
    path : Path
        The file.
    *arguments
        What else it takes.
    """
    if not can_isolate():
        return loaded(function)(path, *arguments)
    worker = _hire()
    try:
        return worker.ask(path, "call", function, str(path), arguments, str(Path.cwd()), max_memory())
    finally:
        _dismiss(worker)


clocks: list[Callable[[float], None]] = []
"""What limits time in this process, if it is a worker."""


def limit_time(share: float) -> None:
    """Start the clock of an answer anew, with a share of the limit of time; does nothing outside of a worker."""
    for start in clocks:
        start(share)


def loaded(reference: str) -> Callable[..., Any]:
    """Return the function that ``"module:function"`` names."""
    module, function = reference.split(":")
    found: Callable[..., Any] = getattr(import_module(module), function)
    return found


def can_isolate() -> bool:
    """Whether a second Python can be started: applications that embed Python have no executable for it."""
    return "python" in Path(sys.executable or "").name.lower()


class _IsolatedReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, worker: _Worker, resources: ExitStack, moving: bool
    ) -> None:
        super().__init__(path, header, resources, moving)
        self._worker = worker
        self._numbers = count()

    def markings(self) -> Markings:
        """Return what tells parts of the mesh apart."""
        found: Markings = self._worker.ask(self.path, "markings")
        return found

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        return self._read("points", size)

    def _read_velocities(self, size: int) -> Iterator[FloatArray]:
        return self._read("velocities", size)

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        number = next(self._numbers)
        self._worker.ask(self.path, "iterate", number, what, size)
        while True:
            block = self._worker.ask(self.path, "next", number)
            if block is None:
                return
            yield block


class _Worker:
    """A child process that answers one question at a time."""

    def __init__(self) -> None:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "mixseq_io.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # where C++ libraries grumble; their reports come with the answers
            env=environment,
        )
        self._lock = threading.Lock()

    def ask(self, path: Path, *question: Any) -> Any:
        """Return the answer to a question about a file; raise the error, and repeat the warnings, that it made."""
        try:
            with self._lock:
                pickle.dump(question, self._stdin)
                self._stdin.flush()
                answer, error, warnings = pickle.load(self._stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise FormatError(self._obituary(path)) from None
        except BaseException:
            # Ctrl-C: the answer that is on its way must not be taken for that to another question.
            self._process.kill()
            raise
        for message in warnings:
            warn(message)
        if error is not None:
            raise error
        return answer

    def close(self) -> None:
        """Let the process end."""
        with suppress(OSError):
            self._stdin.close()
        self._stdout.close()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    @property
    def alive(self) -> bool:
        """Whether it can be asked again."""
        return self._process.poll() is None

    @property
    def _stdin(self) -> Any:
        return self._process.stdin

    @property
    def _stdout(self) -> Any:
        return self._process.stdout

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
            f"{gigabytes(max_memory())} of memory: --max-memory)"
        )


_idle: list[_Worker] = []
_of_parent: list[_Worker] = []
_lock = threading.Lock()


def _hire() -> _Worker:
    with _lock:
        while _idle:
            worker = _idle.pop()
            if worker.alive:
                return worker
            worker.close()
    return _Worker()


def _dismiss(worker: _Worker) -> None:
    """Keep a worker for the next file, if it is well and there are not enough already."""
    with suppress(FormatError):
        if worker.alive:
            worker.ask(Path(), "close")
    with _lock:
        if worker.alive and len(_idle) < _MOST_IDLE:
            _idle.append(worker)
            return
    worker.close()


def _leave_to_parent() -> None:
    """Let a forked process start workers of its own: two askers at one pipe would get each other's answers."""
    _of_parent.extend(_idle)
    _idle.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_to_parent)


@atexit.register
def _dismiss_all() -> None:
    while _idle:
        _idle.pop().close()


def _frozen(header: SequenceHeader) -> SequenceHeader:
    """Make the arrays of a header that came through a pipe read-only again."""
    surface = header.surface
    return replace(
        header,
        polygons=replace(header.polygons),
        surface=replace(
            surface,
            uvs=None if surface.uvs is None else replace(surface.uvs),
            face_sets=tuple(replace(face_set) for face_set in surface.face_sets),
        ),
    )
