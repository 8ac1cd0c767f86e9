"""Base of all readers, whose blocks are checked as they are read, and the checks of blocks on their way to writers."""

from __future__ import annotations

import os
import stat
import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import chain, tee
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import DTypeLike

from mixseq.errors import FormatError, InvalidSequenceError, MixseqError, MixseqWarning, SettingsError
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import check_block
from mixseq.types import FloatArray
from mixseq_io.files import check_memory, max_memory, memory_limit, out_of_memory
from mixseq_io.text.labels import Markings, group_face_sets

Numbered = tuple[int, FloatArray, FloatArray | None]
"""Index of a block's first frame, its points ``(B, V, 3)``, and its velocities or None."""


def checked(
    header: SequenceHeader, blocks: Iterable[FloatArray], velocities: Iterable[FloatArray] | None = None
) -> tuple[np.dtype[np.floating], Iterator[Numbered]]:
    """Return the points' dtype, from the first block, and the numbered blocks, checked as they pass."""
    rest = iter(blocks)
    first = next(rest, None)
    if first is None:
        raise InvalidSequenceError(f"there are no points for the header's {header.frame_count} times")
    dtype = _as_floats(first).dtype
    speeds = None if velocities is None else iter(velocities)
    return dtype, _numbered(header, chain([first], rest), speeds, dtype)


def _numbered(
    header: SequenceHeader,
    blocks: Iterator[FloatArray],
    velocities: Iterator[FloatArray] | None,
    dtype: DTypeLike,
) -> Iterator[Numbered]:
    frame = 0
    for block in blocks:
        points = _as_floats(block)
        check_block(header, points, frame)
        if points.dtype != dtype:
            raise InvalidSequenceError(
                f"{header.frame_name(frame)}: points turn from {dtype} into {points.dtype}; one dtype is expected"
            )
        if frame + len(points) > header.frame_count:
            raise InvalidSequenceError(f"there are more frames of points than {header.frame_count} times")
        yield (
            frame,
            points,
            (None if velocities is None else _like(header, points, next(velocities, None), frame)),
        )
        frame += len(points)
    if frame < header.frame_count:
        raise InvalidSequenceError(f"there are {frame} frames of points for {header.frame_count} times")
    if velocities is not None and next(velocities, None) is not None:
        raise InvalidSequenceError("there are more velocities than points; give one velocity per point")


def _like(header: SequenceHeader, points: FloatArray, block: FloatArray | None, frame: int) -> FloatArray:
    """Return a block of velocities in the dtype of its block of points."""
    if block is None:
        raise InvalidSequenceError(
            f"velocities end before {header.frame_name(frame)}; give one velocity per point"
        )
    velocities = _as_floats(block)
    if velocities.shape != points.shape:
        raise InvalidSequenceError(
            f"velocities from {header.frame_name(frame)} on have shape {velocities.shape}, points {points.shape}; "
            "give as many"
        )
    check_velocities(header, velocities, frame)
    if points.dtype == np.float64:
        return velocities.astype(np.float64, copy=False)
    return as_float32(velocities, frame, "the precision of its point", "the velocity of vertex", header)


def check_velocities(header: SequenceHeader, velocities: FloatArray, first_frame: int) -> None:
    """Check that all velocities ``(B, V, 3)`` of a block are finite."""
    if not np.isfinite(velocities).all():
        frame, vertex = (int(i) for i in np.argwhere(~np.isfinite(velocities))[0, :2])
        raise InvalidSequenceError(
            f"{header.frame_name(first_frame + frame)}: the velocity of vertex {vertex} is "
            f"{velocities[frame, vertex].tolist()}; velocities must be finite"
        )


def _as_floats(block: FloatArray) -> FloatArray:
    points = np.asarray(block)
    if points.dtype not in (np.float32, np.float64):
        points = points.astype(np.float64)
    return np.ascontiguousarray(points)


def in_step(
    pairs: Iterable[tuple[FloatArray, FloatArray]],
) -> tuple[Iterator[FloatArray], Iterator[FloatArray]]:
    """Split pairs of blocks of points and velocities (`Model.moving_blocks`) into two iterators, advanced in turns."""
    one, other = tee(pairs)
    return (points for points, _ in one), (velocities for _, velocities in other)


def as_float32(
    values: FloatArray,
    first_frame: int,
    what: str,
    of: str = "vertex",
    header: SequenceHeader | None = None,
) -> FloatArray:
    """Round points or velocities to float32; errors name the format `what`."""
    with np.errstate(over="ignore", under="ignore"):
        rounded = values.astype(np.float32)
    finite = np.isfinite(rounded)
    if not finite.all():
        frame, vertex = (int(i) for i in np.argwhere(~finite)[0, :2])
        index = first_frame + frame
        name = f"frame {index}" if header is None else header.frame_name(index)
        raise InvalidSequenceError(
            f"{name}: {of} {vertex} is {values[frame, vertex].tolist()}, too large "
            f"for {what}, which stores float32; scale the points down, or write .npz or .h5"
        )
    return rounded


def warn(message: str) -> None:
    """Warn at the line of the first caller outside mixseq."""
    level, frame = 1, sys._getframe()
    ours = ("mixseq", "mixseq_io")
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in ours:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, MixseqWarning, stacklevel=level)


class SequenceReader(ABC):
    """Open file of a mesh sequence, used in a ``with`` statement.

    Subclasses open their file, find the header, and implement `_read`.
    """

    def __init__(
        self,
        path: Path,
        header: SequenceHeader,
        resources: ExitStack | None = None,
        has_velocities: bool = False,
    ) -> None:
        self.path = path
        self.header = header
        self.has_velocities = has_velocities
        self._resources = resources or ExitStack()
        self._closed = False
        self._limit = max_memory()
        self._process = os.getpid()

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over blocks ``(B, V, 3)`` of the points, from the first frame at each call."""
        return self._checked("points", self._read("points", self._fitting(size)), check_block)

    def velocity_blocks(self, size: int = 16) -> Iterator[FloatArray] | None:
        """Iterate over blocks ``(B, V, 3)`` of velocities, in units per second, in step with `blocks` of that size."""
        fitting = self._fitting(size)
        if not self.has_velocities:
            return None
        return self._checked("velocities", self._read("velocities", fitting), check_velocities)

    def check_whole(self) -> None:
        """Raise an error if all frames together take more than `max_memory`."""
        numbers = 3 * self.header.vertex_count * self.header.frame_count * (1 + self.has_velocities)
        with memory_limit(self._limit):
            check_memory(self.path, 4 * numbers, f"all its {self.header.frame_count} frames")

    def markings(self) -> Markings:
        """Return the sets of polygons, and joints where they are read."""
        return Markings(sets=group_face_sets(self.header))

    def close(self) -> None:
        """Close the file; blocks that were read stay valid."""
        self._closed = True
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _fitting(self, size: int) -> int:
        """Return the number of frames of a block that fits the memory limit."""
        if size < 1:
            raise SettingsError(f"block size is {size}; a positive number of frames is expected")
        frame = 3 * 8 * self.header.vertex_count
        with memory_limit(self._limit):
            check_memory(self.path, frame, "a frame")
        return min(size, self._limit // max(frame, 1))

    @abstractmethod
    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        """Yield "points", or "velocities" if the file has any, in blocks of at most `size` frames."""

    def _check_open(self) -> None:
        if self._closed:
            raise FormatError(f"{self.path} is closed; read its blocks inside the with statement")
        self._check_process()

    def _check_process(self) -> None:
        if self._process != os.getpid():  # both would move the place in the file
            raise FormatError(f"{self.path} was opened before this process was forked; open it again here")

    def _checked(
        self,
        what: str,
        blocks: Iterator[FloatArray],
        check: Callable[[SequenceHeader, FloatArray, int], None],
    ) -> Iterator[FloatArray]:
        frame = 0
        while True:
            self._check_open()
            block = next(blocks, None)
            if block is None:
                break
            with naming(self.path):
                check(self.header, block, frame)
            yield block
            frame += len(block)
        if frame != self.header.frame_count:
            raise FormatError(
                f"{self.path}: {frame} frames of {what} for {self.header.frame_count} times; is it truncated?"
            )


@contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Put the file's name before error messages about its sequence."""
    try:
        yield
    except InvalidSequenceError as error:
        raise InvalidSequenceError(f"{path}: {error}") from None


@contextmanager
def reading(path: Path | str, what: str, *errors: type[Exception]) -> Iterator[None]:
    """Translate a library's errors about a bad file into `FormatError`."""
    check_regular(path, what)
    damage: tuple[type[Exception], ...] = (OSError, *errors)
    try:
        yield
    except MixseqError:
        raise
    except FileNotFoundError:
        raise FormatError(f"{path} does not exist") from None
    except IsADirectoryError:
        raise FormatError(f"{path} is a folder, not {what}") from None
    except PermissionError:
        raise FormatError(f"{path}: no permission to read it") from None
    except MemoryError:
        raise out_of_memory(path) from None
    except damage as error:
        raise FormatError(
            f"{path} cannot be read as {what}; it is damaged, truncated or of another type ({brief(error)})"
        ) from error


_OF_TEXT = 6
"""Memory in bytes per byte of text that is parsed into words and numbers in Python."""


def read_whole(path: Path, text: bool = False) -> bytes:
    """Return all bytes of a file, if they fit the memory limit; for `text` including its parsed words."""
    size = path.stat().st_size
    check_memory(
        path, size * _OF_TEXT if text else size, "the file and what is made of it" if text else "the file"
    )
    return path.read_bytes()


def check_regular(path: Path | str, what: str) -> None:
    """Raise an error for a pipe, a socket or a device, since reading it may never end."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):  # not there, or no name that a file can have: its reader will tell
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise FormatError(f"{path} is a pipe, a socket or a device, not {what}; give the name of a file")


def brief(error: BaseException) -> str:
    """Return an error's first line, or its type if it has no text."""
    lines = str(error).strip().splitlines()
    return lines[0].strip() if lines else type(error).__name__
