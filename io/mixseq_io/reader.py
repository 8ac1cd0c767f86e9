"""Define the base class of all readers, check blocks of frames, and translate errors."""

from __future__ import annotations

import os
import stat
import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import chain, tee
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from mixseq.errors import FormatError, InvalidSequenceError, MissingFileError, MixseqError, MixseqWarning, SettingsError
from mixseq.mesh.measures import choose_origin
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import Provenance
from mixseq.sequence.sequence import check_block
from mixseq.types import Float, FloatArray
from mixseq_io.files import check_memory, max_memory, memory_limit, out_of_memory_error
from mixseq_io.text.labels import Markings, group_face_sets

FrameBlock = tuple[int, FloatArray, FloatArray | None]
"""First frame index, points ``(B, V, 3)``, and velocities or None, of a block of frames."""


def validate_blocks(
    header: SequenceHeader, blocks: Iterable[FloatArray], velocities: Iterable[FloatArray] | None = None
) -> tuple[np.dtype[np.floating], Iterator[FrameBlock]]:
    """Return the dtype of the first block of points, and an iterator that checks and yields each block."""
    block_iterator = iter(blocks)
    first_block = next(block_iterator, None)
    if first_block is None:
        raise InvalidSequenceError(f"there are no points for the header's {header.frame_count} times")
    dtype = _as_floats(first_block).dtype
    velocity_iterator = None if velocities is None else iter(velocities)
    return dtype, _validated(header, chain([first_block], block_iterator), velocity_iterator, dtype)


def _validated(
    header: SequenceHeader, blocks: Iterator[FloatArray], velocities: Iterator[FloatArray] | None, dtype: DTypeLike
) -> Iterator[FrameBlock]:
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
        velocity_block = None
        if velocities is not None:
            velocity_block = _validate_velocities(header, points, next(velocities, None), frame)
        yield frame, points, velocity_block
        frame += len(points)
    if frame < header.frame_count:
        raise InvalidSequenceError(f"there are {frame} frames of points for {header.frame_count} times")
    if velocities is not None and next(velocities, None) is not None:
        raise InvalidSequenceError("there are more velocities than points; give one velocity per point")


def _validate_velocities(
    header: SequenceHeader, points: FloatArray, block: FloatArray | None, frame: int
) -> FloatArray:
    """Check a block of velocities, and return it in the dtype of its block of points."""
    if block is None:
        raise InvalidSequenceError(f"velocities end before {header.frame_name(frame)}; give one velocity per point")
    velocities = _as_floats(block)
    if velocities.shape != points.shape:
        raise InvalidSequenceError(
            f"velocities from {header.frame_name(frame)} on have shape {velocities.shape}, points {points.shape}; "
            "give one velocity per point"
        )
    check_velocities(header, velocities, frame)
    if points.dtype == np.float64:
        return velocities.astype(np.float64, copy=False)
    return as_float32(velocities, frame, "the precision of its point", "the velocity of vertex", header)


def check_velocities(header: SequenceHeader, velocities: FloatArray, first_frame: int) -> None:
    """Raise an error unless all velocities ``(B, V, 3)`` of a block are finite."""
    finite = np.isfinite(velocities)
    if not finite.all():
        frame, vertex = (int(i) for i in np.argwhere(~finite)[0, :2])
        raise InvalidSequenceError(
            f"{header.frame_name(first_frame + frame)}: the velocity of vertex {vertex} is "
            f"{velocities[frame, vertex].tolist()}; velocities must be finite"
        )


def _as_floats(block: FloatArray) -> FloatArray:
    array = np.asarray(block)
    if array.dtype not in (np.float32, np.float64):
        array = array.astype(np.float64)
    return np.ascontiguousarray(array)


def unzip_blocks(pairs: Iterable[tuple[FloatArray, FloatArray]]) -> tuple[Iterator[FloatArray], Iterator[FloatArray]]:
    """Split pairs of point and velocity blocks (`Model.moving_blocks`) into two iterators, advanced alternately."""
    for_points, for_velocities = tee(pairs)
    return (points for points, _ in for_points), (velocities for _, velocities in for_velocities)


def as_float32(
    values: FloatArray,
    first_frame: int,
    format_name: str,
    element: str = "vertex",
    header: SequenceHeader | None = None,
) -> FloatArray:
    """Round points or velocities ``(B, V, 3)`` to float32; raise an error if a value overflows."""
    with np.errstate(over="ignore", under="ignore"):
        rounded = values.astype(np.float32)
    finite = np.isfinite(rounded)
    if not finite.all():
        frame, vertex = (int(i) for i in np.argwhere(~finite)[0, :2])
        index = first_frame + frame
        name = f"frame {index}" if header is None else header.frame_name(index)
        raise InvalidSequenceError(
            f"{name}: {element} {vertex} is {values[frame, vertex].tolist()}, too large "
            f"for {format_name}, which stores float32; scale the points down, or write .npz or .h5"
        )
    return rounded


def warn(message: str) -> None:
    """Issue a warning that refers to the line of the first caller outside mixseq."""
    level, frame = 1, sys._getframe()
    own_packages = ("mixseq", "mixseq_io")
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in own_packages:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, MixseqWarning, stacklevel=level)


class SequenceReader(ABC):
    """Open file of a mesh sequence, usable as a context manager; subclasses implement `_read`."""

    def __init__(
        self,
        path: Path,
        header: SequenceHeader,
        resources: ExitStack | None = None,
        has_velocities: bool = False,
        can_evaluate: bool = False,
    ) -> None:
        self.path = path
        self.header = header if header.provenance else replace(header, provenance=Provenance(path.name))
        self.has_velocities = has_velocities
        self.can_evaluate = can_evaluate
        self._resources = resources or ExitStack()
        self._point_type: DTypeLike | None = None
        self._closed = False
        self._memory_limit = max_memory()
        self._process_id = os.getpid()

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over all points in blocks ``(B, V, 3)`` of at most `size` frames."""
        return self._checked("points", self._read("points", self._block_size(size)), check_block)

    def velocity_blocks(self, size: int = 16) -> Iterator[FloatArray] | None:
        """Iterate over all velocities, in units per second, in the same blocks as `blocks`; None if there are none."""
        block_size = self._block_size(size)
        if not self.has_velocities:
            return None
        return self._checked("velocities", self._read("velocities", block_size), check_velocities)

    def blocks_at(self, times: ArrayLike, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over the points of a rig at times ``(N,)`` in s of the header, in blocks of at most `size` frames.

        Joints, morph weights and transforms are interpolated between keys as the file's format defines, and held before
        the first frame and after the last. Raises `SettingsError` unless `can_evaluate`.
        """
        return self._evaluated("points", times, size)

    def velocity_blocks_at(self, times: ArrayLike, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over the velocities of a rig, in units per second, by central differences; see `blocks_at`."""
        return self._evaluated("velocities", times, size)

    def check_total_memory(self) -> None:
        """Raise an error if all frames together would exceed the memory limit in single precision."""
        coordinate_count = 3 * self.header.vertex_count * self.header.frame_count * (1 + self.has_velocities)
        with memory_limit(self._memory_limit):
            check_memory(self.path, 4 * coordinate_count, f"all its {self.header.frame_count} frames")

    def markings(self) -> Markings:
        """Return the named face sets of the mesh, and its skinning weights if the format has any."""
        return Markings(sets=group_face_sets(self.header))

    def close(self) -> None:
        """Close the file."""
        self._closed = True
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _block_size(self, size: int) -> int:
        """Return the largest number of frames, at most `size`, that fits the memory limit in double precision."""
        if size < 1:
            raise SettingsError(f"block size is {size}; a positive number of frames is expected")
        bytes_per_frame = 3 * 8 * self.header.vertex_count
        with memory_limit(self._memory_limit):
            check_memory(self.path, bytes_per_frame, "a frame")
        return min(size, self._memory_limit // max(bytes_per_frame, 1))

    @abstractmethod
    def _read(self, quantity: str, size: int) -> Iterator[FloatArray]:
        """Yield the quantity "points" or "velocities" in blocks of at most `size` frames."""

    def _evaluate(self, quantity: str, frames: Float, size: int) -> Iterator[FloatArray]:
        """Yield the quantity at fractional frame indices ``(N,)``, if the reader `can_evaluate`."""
        raise NotImplementedError

    def _evaluated(self, quantity: str, times: ArrayLike, size: int) -> Iterator[FloatArray]:
        if not self.can_evaluate:
            raise SettingsError(
                f"{self.path} has no rig to evaluate, only points of its frames; mixseq.fit makes a model of them, "
                "which has points at any time"
            )
        own_times = self.header.times
        frames = np.interp(np.asarray(times, np.float64).reshape(-1), own_times, np.arange(float(own_times.size)))
        return self._while_open(self._evaluate(quantity, frames, self._block_size(size)))

    def _while_open(self, blocks: Iterator[FloatArray]) -> Iterator[FloatArray]:
        self._check_open()
        for block in blocks:
            yield block
            self._check_open()

    def _check_open(self) -> None:
        if self._closed:
            raise FormatError(f"{self.path} is closed; read its blocks inside the with statement")
        if self._process_id != os.getpid():  # both processes would share one position in the file
            raise FormatError(f"{self.path} was opened before this process was forked; open it again here")

    def _round(self, points: FloatArray) -> FloatArray:
        """Round computed points ``(B, V, 3)`` to single precision, unless the first ones are far from zero."""
        if self._point_type is None and points.size:
            with np.errstate(all="ignore"):
                is_exact = np.array_equal(points[0].astype(np.float32), points[0])
            is_far = not is_exact and choose_origin(points[0]).any()
            self._point_type = np.float64 if is_far else np.float32
        return points.astype(self._point_type or np.float32, copy=False)

    def _checked(
        self, quantity: str, blocks: Iterator[FloatArray], check: Callable[[SequenceHeader, FloatArray, int], None]
    ) -> Iterator[FloatArray]:
        frame = 0
        for block in self._while_open(blocks):
            with prefix_errors(self.path):
                check(self.header, block, frame)
            yield block
            frame += len(block)
        if frame != self.header.frame_count:
            raise FormatError(
                f"{self.path}: {frame} frames of {quantity} for {self.header.frame_count} times; is it truncated?"
            )


_STEPS_PER_FRAME = 64
"""Steps of difference quotients per mean frame: small for curved paths, large for float32 rounding of points."""


class AnimationReader(SequenceReader):
    """Reader of points at any animation time; subclasses set the times of frames, `_frame_times` ``(T,)``."""

    _frame_times: Float

    @abstractmethod
    def _points_at(self, times: Float, step_times: Float) -> FloatArray:
        """Return the points ``(B, V, 3)`` at animation times ``(B,)``, with stepped channels at `step_times`."""

    def _evaluate(self, quantity: str, frames: Float, size: int) -> Iterator[FloatArray]:
        for start in range(0, frames.size, size):
            times = np.interp(frames[start : start + size], np.arange(self._frame_times.size), self._frame_times)
            with np.errstate(all="ignore"):  # points that are not finite are reported with their vertex
                if quantity == "points":
                    block = self._round(self._points_at(times, times))
                else:
                    block = self._velocities_at(times).astype(np.float32, copy=False)
            yield block

    def _velocities_at(self, times: Float) -> FloatArray:
        first, last = self._frame_times[[0, -1]]
        step = (last - first) / max(self._frame_times.size - 1, 1) / _STEPS_PER_FRAME
        before, after = np.maximum(times - step, first), np.minimum(times + step, last)
        seconds = (after - before) * np.ptp(self.header.times) / ((last - first) or 1.0)
        moved = self._points_at(after, times).astype(np.float64) - self._points_at(before, times)
        return np.asarray(moved / np.where(seconds > 0, seconds, 1.0)[:, None, None])


@contextmanager
def prefix_errors(path: Path | str) -> Iterator[None]:
    """Prefix the messages of `InvalidSequenceError` with a file's path."""
    try:
        yield
    except InvalidSequenceError as error:
        raise InvalidSequenceError(f"{path}: {error}") from None


@contextmanager
def translate_read_errors(path: Path | str, kind: str, *errors: type[Exception]) -> Iterator[None]:
    """Translate operating system errors, and a library's `errors` about damaged files, into `FormatError`."""
    check_regular_file(path, kind)
    damage: tuple[type[Exception], ...] = (OSError, *errors)
    try:
        yield
    except MixseqError:
        raise
    except FileNotFoundError:
        raise MissingFileError(f"{path} does not exist") from None
    except IsADirectoryError:
        raise FormatError(f"{path} is a folder, not {kind}") from None
    except PermissionError:
        raise FormatError(f"{path}: no permission to read it") from None
    except MemoryError:
        raise out_of_memory_error(path) from None
    except damage as error:
        reason = _describe_damage(error)
        raise FormatError(
            f"{path} cannot be read as {kind}; it is damaged, truncated or of another type"
            + (f" ({reason})" if reason else "")
        ) from error


class DamageError(ValueError):
    """Damage that a parser of mixseq finds in a file, in words for users."""


def _describe_damage(error: BaseException) -> str:
    """Describe damage in the words of mixseq or of the operating system, never in those of libraries."""
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    if isinstance(error, KeyError) and str(error.args[0]).replace("/", "_").isidentifier():
        return f"it has no {error.args[0]}"
    return str(error) if isinstance(error, DamageError) else ""


_PARSED_BYTES_PER_BYTE = 6
"""Bytes of memory that Python needs for words and numbers, per byte of parsed text."""


def read_bytes(path: Path, text: bool = False) -> bytes:
    """Return a file's bytes; raise an error if the bytes, or the parsed words of `text`, exceed the memory limit."""
    size = path.stat().st_size
    if text:
        check_memory(path, size * _PARSED_BYTES_PER_BYTE, "the file and its parsed numbers")
    else:
        check_memory(path, size, "the file")
    return path.read_bytes()


def check_regular_file(path: Path | str, kind: str) -> None:
    """Raise an error if a path is a pipe, a socket or a device, which may be endless."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):  # the reader reports missing files and invalid names
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise FormatError(f"{path} is a pipe, a socket or a device, not {kind}; give the name of a file")


def summarize_error(error: BaseException) -> str:
    """Return the first line of an error's message, or its type if the message is empty."""
    lines = str(error).strip().splitlines()
    return lines[0].strip() if lines else type(error).__name__
