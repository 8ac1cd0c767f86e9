"""Worker process of `mixseq_io.isolation`: opens one file at a time and answers requests about it.

Requests and answers are pickles on stdin and stdout:

- ``("open", reader, path, options, folder, limit)``: the header, and whether there are velocities
- ``("markings",)``: sets of polygons and joints
- ``("iterate", number, what, size, start)``: starts an iteration over points or velocities at the block `start`
- ``("next", number)``: its next block or None
- ``("close",)``: closes the file
- ``("call", function, path, arguments, folder, limit)``: the result of a function of a file

The limit is that of memory in bytes. An answer is the value, the exception raised or None, and the warnings. The
process ends when stdin does.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.errors import MixseqError
from mixseq_io.files import MEMORY_LIMIT_VARIABLE, out_of_memory_error
from mixseq_io.isolation import import_function, time_limiters
from mixseq_io.reader import SequenceReader

_SECONDS = float(os.environ.get("MIXSEQ_READER_SECONDS", "120"))
_PATIENCE = 4
"""Ratio of the clock's time limit to the processor's, for a busy machine."""


class Worker:
    """Open file and its iterations."""

    def __init__(self) -> None:
        self._reader: SequenceReader | None = None
        self._iterations: dict[int, Iterator[Any]] = {}
        self._path = ""

    def answer(self, kind: str, *arguments: Any) -> Any:
        """Answer a request; see the head of the module."""
        return getattr(self, f"_{kind}")(*arguments)

    def _call(self, function: str, path: str, arguments: tuple[Any, ...], folder: str, limit: int) -> Any:
        found = import_function(function)
        self._begin(path, folder, limit)
        return found(Path(path), *arguments)

    def _open(self, reader: str, path: str, options: dict[str, Any], folder: str, limit: int) -> Any:
        found = import_function(reader)
        self._begin(path, folder, limit)
        self._reader = found(Path(path), **options)
        return self._reader.header, self._reader.has_velocities

    def _begin(self, path: str, folder: str, limit: int) -> None:
        self._path = path
        os.chdir(folder)
        limit_memory(limit)

    def _markings(self) -> Any:
        assert self._reader is not None
        return self._reader.markings()

    def _iterate(self, number: int, what: str, size: int, start: int) -> None:
        assert self._reader is not None
        self._iterations[number] = blocks = iter(self._reader._read(what, size))
        for _ in range(start):
            next(blocks, None)
            limit_time(1)  # each had as much

    def _next(self, number: int) -> Any:
        block = next(self._iterations[number], None)
        if block is None:
            del self._iterations[number]
        return block

    def _close(self) -> None:
        self._iterations.clear()
        if self._reader is not None:
            self._reader.close()
        self._reader = None

    def guarded(self, question: tuple[Any, ...]) -> tuple[Any, Exception | None, list[str]]:
        """Answer a request; return the value, the exception raised or None, and the warnings."""
        answer: Any = None
        error: Exception | None = None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                with np.errstate(all="ignore"):  # non-finite points are reported with frame and vertex
                    answer = self.answer(*question)
            except MixseqError as raised:
                error = raised
            except MemoryError:
                error = out_of_memory_error(self._path)
            except Exception:  # a bug: the other side shows where it was
                error = RuntimeError(f"in the reader's process:\n{traceback.format_exc()}")
        return answer, error, [str(warning.message) for warning in caught]


def limit_memory(most: int) -> None:
    """Limit the memory that allocations may add to the process, in bytes; memory-mapped files do not count."""
    os.environ[MEMORY_LIMIT_VARIABLE] = str(most / (1 << 30))  # what `max_memory` returns from here on
    try:
        import resource
    except ImportError:  # Windows
        return
    most += _memory_used()
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (most if hard < 0 else min(most, hard), hard))


def _memory_used() -> int:
    """Return the bytes that count for the limit, 0 where the system does not report them."""
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[5]
    except OSError:  # not Linux
        return 0
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def limit_time(share: float) -> None:
    """End the process after a share of the time limit, by processor or clock; 0 removes the limit."""
    if hasattr(signal, "setitimer"):
        # Without handlers: Python's would wait for the library to return.
        signal.setitimer(signal.ITIMER_PROF, share * _SECONDS)
        signal.setitimer(signal.ITIMER_REAL, _PATIENCE * share * _SECONDS)


def main() -> None:
    """Answer requests until stdin ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the other side, which closes stdin
    questions = sys.stdin.buffer
    # C++ libraries print to stdout, too; it is kept for answers under another number.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    time_limiters.append(limit_time)
    worker = Worker()
    while True:
        try:
            question = pickle.load(questions)
        except EOFError:
            break
        limit_time(1)
        answer = worker.guarded(question)
        limit_time(0)
        try:
            pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
            answers.flush()
        except BrokenPipeError:
            break
    os._exit(0)  # without the destructors of C++ libraries, which a damaged file may have left in disorder


if __name__ == "__main__":
    main()
