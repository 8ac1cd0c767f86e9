"""Run the worker process of `mixseq_io.isolation`, which opens one file at a time and answers requests about it.

Requests and answers are pickles on stdin and stdout. Requests and the values of their answers are:

- ``("open", reader, path, options, folder, limit)``: header of the opened file, whether it has velocities,
  and whether it can be evaluated at any time
- ``("markings",)``: face sets and skinning weights of the mesh
- ``("iterate", iteration, quantity, size, frames)``: None; iterate over points or velocities, evaluated at fractional
  frame indices unless `frames` is None
- ``("next", iteration)``: next block of an iteration, or None at its end
- ``("close",)``: None; the file is closed
- ``("call", function, path, arguments, folder, limit)``: result of a function that is called with a path

`limit` is the memory limit in bytes. An answer is a tuple of value, raised exception or None, and warnings. The process
ends when stdin ends.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.errors import MixseqError
from mixseq.types import Float
from mixseq_io.files import MEMORY_LIMIT_VARIABLE, out_of_memory_error
from mixseq_io.isolation import import_function, time_limiters
from mixseq_io.reader import SequenceReader

_TIME_LIMIT_SECONDS = float(os.environ.get("MIXSEQ_READER_SECONDS", "120"))
_WALL_TIME_RATIO = 4
"""Ratio of the wall-clock limit to the processor-time limit; a high ratio allows for busy machines."""


class RequestHandler:
    """State of the worker: the open file and its iterations."""

    def __init__(self) -> None:
        self._reader: SequenceReader | None = None
        self._iterations: dict[int, Iterator[Any]] = {}
        self._path = ""

    def handle(self, request: tuple[Any, ...]) -> tuple[Any, Exception | None, list[str]]:
        """Return the value of the answer to a request, the raised exception or None, and the warnings."""
        value: Any = None
        error: Exception | None = None
        kind, *arguments = request
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                with np.errstate(all="ignore"):  # readers report non-finite points with frame and vertex
                    value = getattr(self, f"_{kind}")(*arguments)
            except MixseqError as raised:
                error = raised
            except MemoryError:
                error = out_of_memory_error(self._path)
            except Exception:  # a bug, whose traceback is sent
                error = RuntimeError(f"in the reader's process:\n{traceback.format_exc()}")
        return value, error, [str(warning.message) for warning in caught]

    def _call(self, function: str, path: str, arguments: tuple[Any, ...], folder: str, limit: int) -> Any:
        imported = import_function(function)
        self._begin(path, folder, limit)
        return imported(Path(path), *arguments)

    def _open(self, reader: str, path: str, options: dict[str, Any], folder: str, limit: int) -> Any:
        imported = import_function(reader)
        self._begin(path, folder, limit)
        self._reader = imported(Path(path), **options)
        return self._reader.header, self._reader.has_velocities, self._reader.can_evaluate

    def _begin(self, path: str, folder: str, limit: int) -> None:
        self._path = path
        os.chdir(folder)
        limit_memory(limit)

    def _markings(self) -> Any:
        assert self._reader is not None
        return self._reader.markings()

    def _iterate(self, iteration: int, quantity: str, size: int, frames: Float | None) -> None:
        reader = self._reader
        assert reader is not None
        blocks = reader._read(quantity, size) if frames is None else reader._evaluate(quantity, frames, size)
        self._iterations[iteration] = blocks

    def _next(self, iteration: int) -> Any:
        block = next(self._iterations[iteration], None)
        if block is None:
            del self._iterations[iteration]
        return block

    def _close(self) -> None:
        self._iterations.clear()
        if self._reader is not None:
            self._reader.close()
        self._reader = None


def limit_memory(limit: int) -> None:
    """Limit the bytes that the process may additionally allocate; memory-mapped files do not count."""
    os.environ[MEMORY_LIMIT_VARIABLE] = str(limit / (1 << 30))  # read by `mixseq_io.files.max_memory`
    try:
        import resource
    except ImportError:  # Windows
        return
    with suppress(OSError):  # only Linux states the memory that counts
        limit += int(Path("/proc/self/statm").read_text(encoding="ascii").split()[5]) * os.sysconf("SC_PAGE_SIZE")
    _, hard_limit = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (limit if hard_limit < 0 else min(limit, hard_limit), hard_limit))


def limit_time(fraction: float) -> None:
    """Set the process to end after a fraction of the time limits; 0 removes the limits."""
    if hasattr(signal, "setitimer"):
        # These signals have no handlers, since a Python handler runs only after the library has returned.
        signal.setitimer(signal.ITIMER_PROF, fraction * _TIME_LIMIT_SECONDS)
        signal.setitimer(signal.ITIMER_REAL, _WALL_TIME_RATIO * fraction * _TIME_LIMIT_SECONDS)


def main() -> None:
    """Answer requests until stdin ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles Ctrl-C and closes stdin
    requests = sys.stdin.buffer
    # C++ libraries print to stdout. Therefore answers use a separate descriptor, and stdout is redirected to stderr.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    time_limiters.append(limit_time)
    handler = RequestHandler()
    while True:
        try:
            request = pickle.load(requests)
        except EOFError:
            break
        limit_time(1)
        answer = handler.handle(request)
        limit_time(0)
        try:
            pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
            answers.flush()
        except BrokenPipeError:
            break
    os._exit(0)  # avoids destructors of C++ libraries, whose state a damaged file may have corrupted


if __name__ == "__main__":
    main()
