"""Arrays that may be larger than memory, written by rows and read by rows or columns, and running statistics.

Fitting reads a few coordinates of all frames (the Gram matrix), or all coordinates of a few frames. Small arrays are in
memory. Large arrays are in tiles on disk, so that rows and columns are both read in long runs of bytes:

>>> array = new_large_array((3, 2))
>>> array[0:3] = np.arange(6).reshape(3, 2)
>>> [block.sum(axis=0).tolist() for _, block in column_blocks(array)]
[[6.0, 9.0]]

`RunningStatistics` of streamed values store only the largest values.
"""

from __future__ import annotations

import tempfile
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import IO, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mixseq.errors import OutputError
from mixseq.types import Float

MAX_BYTES_IN_MEMORY = 1 << 25
"""Arrays up to this size are in memory, larger ones on disk."""

_MAX_TILE_COLUMNS = 1 << 14
_MAX_TILE_NUMBERS = 1 << 23  # limits the number of columns per tile in arrays with many rows


class DiskArray:
    """An array ``(T, ...)`` in an unnamed file that is deleted with the object or the process.

    Rows are written by slices and read by slices or indices. Several threads may read at a time.
    """

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> None:
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self._width = int(np.prod(shape[1:], dtype=np.int64))
        try:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the array
        except OSError as error:
            raise OutputError(
                f"there is no folder for temporary files ({error.strerror}); set TMPDIR to an existing folder"
            ) from error
        self._lock = threading.Lock()  # a file has one read position
        weakref.finalize(self, _close, self._file)

    def __len__(self) -> int:
        return self.shape[0]

    def __setitem__(self, rows: slice, values: NDArray[Any]) -> None:
        first, last, _ = rows.indices(len(self))
        flat = values.reshape(last - first, self._width)
        for columns in _tiles(len(self), self._width):
            self._write(first, columns, flat[:, columns])

    def _write(self, first: int, columns: slice, values: NDArray[Any]) -> None:
        try:
            self._seek(first, columns)
            self._file.write(np.ascontiguousarray(values, dtype=self.dtype).data)
            self._file.flush()
        except OSError as error:
            size = self.dtype.itemsize * len(self) * self._width
            raise OutputError(
                f"cannot write a temporary file of {size / 1e9:.1f} GB in {tempfile.gettempdir()}: {error.strerror}; "
                "free some space, or set TMPDIR to another folder"
            ) from error

    def __getitem__(self, rows: slice | NDArray[np.integer]) -> NDArray[Any]:
        row_ids = np.arange(len(self))[rows]
        flat = np.empty((len(row_ids), self._width), dtype=self.dtype)
        # Consecutive rows are read at once.
        ends = np.flatnonzero(np.diff(row_ids, prepend=-9, append=-9) != 1)
        for start, stop in pairwise(ends):
            for columns in _tiles(len(self), self._width):
                flat[start:stop, columns] = self._read(int(row_ids[start]), int(stop - start), columns)
        return flat.reshape(len(row_ids), *self.shape[1:])

    def columns(self) -> Iterator[tuple[slice, NDArray[Any]]]:
        """Yield column slices of the flattened rows, and their values ``(T, C)``."""
        for columns in _tiles(len(self), self._width):
            yield columns, self._read(0, len(self), columns)

    def _seek(self, row: int, columns: slice) -> None:
        self._file.seek(self.dtype.itemsize * (len(self) * columns.start + row * (columns.stop - columns.start)))

    def _read(self, first: int, count: int, columns: slice) -> NDArray[Any]:
        block = np.empty((count, columns.stop - columns.start), dtype=self.dtype)
        with self._lock:
            self._seek(first, columns)
            byte_count = self._file.readinto(block.data.cast("B"))
        if byte_count < block.nbytes:
            raise OutputError("a temporary file is incomplete; free some disk space")
        return block


def _close(file: IO[bytes]) -> None:
    with suppress(OSError):  # ignore a full disk, as the data are no longer needed
        file.close()


LargeArray = NDArray[Any] | DiskArray
"""An array in memory or on disk."""


def new_large_array(shape: tuple[int, ...], dtype: DTypeLike = np.float64) -> LargeArray:
    """Return an uninitialised array ``(T, ...)``, on disk if the array is large."""
    size = np.dtype(dtype).itemsize * int(np.prod(shape, dtype=np.int64))
    return np.empty(shape, dtype) if size <= MAX_BYTES_IN_MEMORY else DiskArray(shape, dtype)


def from_columns(shape: tuple[int, int], columns_of: Callable[[slice], Float]) -> LargeArray:
    """Return an array ``(T, W)``, on disk if it is large, from a function that returns columns ``(T, C)``."""
    array = new_large_array(shape)
    for columns in _tiles(*shape):
        if isinstance(array, DiskArray):
            array._write(0, columns, columns_of(columns))
        else:
            array[:, columns] = columns_of(columns)
    return array


def column_blocks(array: LargeArray) -> Iterator[tuple[slice, NDArray[Any]]]:
    """Yield column slices of an array ``(T, W)`` and their values ``(T, C)``; slices match in memory and on disk."""
    if isinstance(array, DiskArray):
        yield from array.columns()
        return
    for columns in _tiles(*array.shape):
        yield columns, np.ascontiguousarray(array[:, columns])


def _tiles(row_count: int, width: int) -> Iterator[slice]:
    """Yield the column slices in which an array ``(row_count, width)`` is stored and read."""
    step = min(_MAX_TILE_COLUMNS, max(_MAX_TILE_NUMBERS // max(row_count, 1), 64))
    for start in range(0, width, step):
        yield slice(start, min(start + step, width))


def return_freed_memory() -> None:
    """Return freed memory to the system; glibc keeps it where other memory is still in use behind it."""
    import ctypes  # slow to import

    with suppress(OSError, AttributeError, TypeError):  # other C libraries cannot be asked
        ctypes.CDLL(None).malloc_trim(0)


P999_QUANTILE = 0.999


@dataclass(frozen=True)
class Statistics:
    """Statistics of one error over all elements and frames."""

    rms: float  # root mean square
    p999: float  # 99.9th percentile: the smallest value that 99.9 % do not exceed
    max: float  # largest value
    skipped: int  # number of undefined values, over all frames


class RunningStatistics:
    """Accumulate `Statistics` block by block, as the sum of squares and the largest values."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._count = 0
        self._square_sum = 0.0
        self._kept_count = total - int(P999_QUANTILE * total) + 1
        self._largest = np.zeros(0)

    def add(self, values: Float) -> None:
        """Add non-negative values ``(n,)``; skip values that are not finite."""
        values = values[np.isfinite(values)]
        self._count += values.size
        self._square_sum += float(np.square(values).sum())
        if len(self._largest) == self._kept_count:
            values = values[values > self._largest[0]]
        largest = np.concatenate([self._largest, values])
        if len(largest) >= self._kept_count:
            # The smallest kept value comes first.
            largest = np.partition(largest, len(largest) - self._kept_count)[-self._kept_count :]
        self._largest = largest

    def result(self) -> Statistics:
        """Return the statistics of all added values; zeros if none are finite."""
        if not self._count:
            return Statistics(rms=0.0, p999=0.0, max=0.0, skipped=self._total)
        above_count = self._count - int(np.ceil(P999_QUANTILE * self._count))
        return Statistics(
            rms=float(np.sqrt(self._square_sum / self._count)),
            p999=float(np.sort(self._largest)[-1 - above_count]),
            max=float(self._largest.max()),
            skipped=self._total - self._count,
        )
