"""Readers that misbehave as C++ libraries do, for `test_isolation`."""

from __future__ import annotations

import os
import signal
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mixseq.errors import InvalidSequenceError, MixseqWarning
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray
from mixseq_io.reader import SequenceReader

HEADER = SequenceHeader(polygons=Polygons(np.array([3]), np.array([0, 1, 2])), vertex_count=3, times=np.arange(4.0))


def open_file(path: Path, how: str = "well", when: str = "opening") -> SequenceReader:
    """Open a file; do something `how` when `opening` or `reading`; let it be evaluated when `evaluating`."""
    if when == "opening":
        misbehave(how, path)
    return _Reader(path, how if when == "reading" else "well", when == "evaluating")


class _Reader(SequenceReader):
    def __init__(self, path: Path, how: str, can_evaluate: bool) -> None:
        super().__init__(path, HEADER, has_velocities=True, can_evaluate=can_evaluate)
        self._how = how

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        for start in range(0, 4, size):
            if start:
                misbehave(self._how, self.path)
            value = start if what == "points" else -start
            yield np.full((min(size, 4 - start), 3, 3), value, dtype=np.float32)

    def _evaluate(self, quantity: str, frames: Float, size: int) -> Iterator[FloatArray]:
        for start in range(0, len(frames), size):
            yield np.tile(frames[start : start + size, None, None], (3, 3))


def misbehave(how: str, path: Path) -> None:
    """Crash, hang, take memory, grumble, warn, or fail."""
    if how == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif how == "hang":
        while True:
            pass
    elif how == "wait":
        time.sleep(60)
    elif how == "memory":
        np.zeros(1 << 40)
    elif how == "print":
        os.write(1, b"Coding Error: in C++")
        os.write(2, b"Coding Error: in C++")
    elif how == "warn":
        warnings.warn("something is lost", MixseqWarning, stacklevel=2)
    elif how == "error":
        raise InvalidSequenceError(f"{path}: it is unsound")
    elif how == "bug":
        raise ZeroDivisionError("by our own mistake")
