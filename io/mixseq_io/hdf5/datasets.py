"""Write arrays and settings to HDF5 with checksums, and check their type, shape and range when reading them.

Datasets have Fletcher-32 checksums. The HDF5 1.10 layout has checksums of the file's structure.

Specification: https://support.hdfgroup.org/documentation/hdf5/latest/_f_m_t3.html
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import IO, Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError, OutputError
from mixseq.runtime.interrupts import uninterrupted
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MAX_LENGTH, MIN_LENGTH
from mixseq.signals.curve import is_increasing
from mixseq.types import Float, Index
from mixseq_io.files import atomic_file
from mixseq_io.hdf5.contents import Contents
from mixseq_io.surfaces import surface_to_arrays

STORAGE_OPTIONS: dict[str, Any] = {"fletcher32": True, "shuffle": True, "compression": "gzip", "compression_opts": 6}
"""Storage options of all datasets that are not empty."""

_CHUNK_ROWS, _CHUNK_COLUMNS = 64, 2048
"""Largest shape of chunks; few columns let gzip's window of 32 KiB cover several similar rows."""


def write_text(group: h5py.Group, name: str, text: str) -> None:
    """Store a text as an attribute of fixed length; strings of variable length have no checksum."""
    data = text.encode("utf-8", "surrogateescape")
    group.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", max(1, len(data))))


def write_array(file: h5py.Group, name: str, array: NDArray[Any]) -> None:
    """Store an array in chunks of at most 1 MiB, and flush the file, so that equal contents give equal files.

    Otherwise HDF5 allocates the data when the last reference to the dataset is dropped, which debuggers may delay.
    """
    options = STORAGE_OPTIONS | {"chunks": _chunk_shape(array.shape)} if array.size else {}
    file.create_dataset(name, data=array, **options)
    file.file.flush()


def _chunk_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    if len(shape) == 1:
        return (min(shape[0], _CHUNK_ROWS * _CHUNK_COLUMNS),)
    count, columns, *rest = shape
    return (min(count, _CHUNK_ROWS), min(columns, max(1, _CHUNK_COLUMNS // prod(rest))), *rest)


MAX_BODIES = 100
"""Largest number of further bodies in a file."""


def body_groups(file: h5py.File, count: int) -> Iterator[h5py.Group]:
    """Return an iterator that makes the groups of further bodies: ``bodies/0``, ``bodies/1``, ..."""
    if count > MAX_BODIES:
        raise OutputError(f"the model has {count} further bodies; a file holds {MAX_BODIES}")
    return (file.require_group(f"bodies/{number}") for number in range(count))


def write_header(file: h5py.Group, header: SequenceHeader) -> None:
    """Store all fields of a header except its times."""
    write_text(file, "name", header.name)
    file.attrs["fps"] = header.fps
    write_text(file, "up_axis", header.up_axis)
    file.attrs["metres_per_unit"] = header.metres_per_unit
    write_array(file, "polygons/counts", header.polygons.counts)
    write_array(file, "polygons/indices", header.polygons.indices)
    for name, array in surface_to_arrays(header.surface).items():
        if array.dtype.kind == "U":
            array = np.char.encode(array, "utf-8")  # text of fixed length, as in `write_text`
        write_array(file, f"surface/{name}", array)


H5_VERSIONS = ("v110", "v110")
"""Oldest and newest version of HDF5 whose layouts files have."""


@contextmanager
def create_h5(path: Path) -> Iterator[tuple[h5py.File, DeferredErrorFile]]:
    """Yield a new HDF5 file that replaces `path` when complete, and the file object, which records write errors."""
    with atomic_file(path) as temporary, temporary.open("w+b", buffering=0) as raw:
        buffer = DeferredErrorFile(raw)
        with h5py.File(buffer, "w", libver=H5_VERSIONS) as file:
            yield file, buffer
        buffer.check()


class DeferredErrorFile:
    """File object for HDF5 that defers errors: all writes seem to succeed, and `check` raises the first error.

    This is necessary because HDF5 crashes after a failed write and cannot propagate exceptions of Python callbacks.
    Writes after an error are ignored. Signals are deferred until the callback returns.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._error: BaseException | None = None

    def check(self) -> None:
        """Raise the first deferred error, if any."""
        if self._error is not None:
            raise self._error

    @uninterrupted
    def write(self, data: memoryview) -> int:
        """Write data, and return its number of bytes even if the write fails."""
        try:
            remaining = memoryview(data)
            while remaining and self._error is None:
                remaining = remaining[self._file.write(remaining) :]
        except BaseException as error:
            self._error = error
        return len(data)

    @uninterrupted
    def truncate(self, size: int) -> int:
        """Set the file's size."""
        try:
            if self._error is None:
                return self._file.truncate(size)
        except BaseException as error:
            self._error = error
        return size

    @uninterrupted
    def seek(self, offset: int, whence: int = 0) -> int:
        """Move to a position in bytes."""
        return self._file.seek(offset, whence)

    @uninterrupted
    def tell(self) -> int:
        """Return the position in bytes."""
        return self._file.tell()

    @uninterrupted
    def read(self, size: int = -1) -> bytes:
        """Read bytes."""
        return self._file.read(size)

    @uninterrupted
    def flush(self) -> None:
        """Do nothing, since the file is unbuffered and `atomic_file` flushes the file to disk."""


MAX_LENGTH_DIAGONALS = 1e20
"""Limit on lengths and positions, so small that products of several values are finite."""

_DTYPE_KINDS = {"integers": "iu", "floats": "f"}


def write_compact(file: h5py.Group, name: str, array: NDArray[Any]) -> None:
    """Store an array, in single precision if the conversion is lossless."""
    if array.dtype == np.float64 and array.size:
        with np.errstate(over="ignore"):
            single = array.astype(np.float32)
        array = single if np.array_equal(single, array) else array
    write_array(file, name, array)


def write_index_lists(file: h5py.Group, group: str, name: str, lists: Sequence[NDArray[Any]]) -> None:
    """Store several lists of indices as one ragged array."""
    write_ragged(file, group, name, np.array(list(map(len, lists))), np.concatenate([*lists, np.zeros(0)]))


def write_ragged(file: h5py.Group, group: str, name: str, sizes: NDArray[np.integer], items: NDArray[Any]) -> None:
    """Store a ragged array of indices, given the sizes of its rows and the concatenated rows."""
    write_compact(file, f"{group}/sizes", sizes.astype(np.int32))
    write_compact(file, f"{group}/{name}", items.astype(np.int32))


def read_index_lists(file: Contents, group: str, name: str, limit: int) -> list[Index]:
    """Read lists of indices, which must be less than `limit`."""
    sizes, items = read_ragged(file, group, name, limit)
    return np.split(items, np.cumsum(sizes))[: len(sizes)]


def read_ragged(file: Contents, group: str, name: str, limit: int) -> tuple[Index, Index]:
    """Read the sizes of the rows of a ragged array, none of which may be empty, and the concatenated rows."""
    sizes = read_integers(file, f"{group}/sizes", (None,), 1)
    return sizes, read_integers(file, f"{group}/{name}", (int(sizes.sum()),), 0, limit)


def read_integers(
    file: Contents, name: str, shape: tuple[int | None, ...], low: int, limit: int | None = None
) -> Index:
    """Read an array of integers in ``[low, limit)``; None in `shape` allows any length."""
    array = _read_array(file, name, shape, "integers")
    if array.size and (array.min() < low or (limit is not None and array.max() >= limit)):
        upper = "" if limit is None else f" to {limit - 1}"
        raise FormatError(f"{file.path}: {name} has values outside {low}{upper}; it is damaged")
    return array.astype(np.int64)


def read_floats(file: Contents, name: str, shape: tuple[int | None, ...], limit: float = MAX_LENGTH) -> Float:
    """Read an array of finite numbers with magnitudes up to `limit`; None in `shape` allows any length."""
    array = _read_array(file, name, shape, "floats")
    if not np.isfinite(array).all():
        raise FormatError(f"{file.path}: {name} is not finite in row {np.argwhere(~np.isfinite(array))[0, 0]}")
    array = array.astype(np.float64)
    magnitude = np.abs(array)
    if array.size and magnitude.max() > limit:
        row = np.argwhere(magnitude > limit)[0, 0]
        raise FormatError(f"{file.path}: {name} has {magnitude.max():g} in row {row}, beyond {limit:g}; it is damaged")
    return array


def read_increasing_times(file: Contents, name: str, of_curve: bool = False) -> Float:
    """Read one or more strictly increasing times ``(n,)``; knots of a curve may be given twice."""
    times = read_floats(file, name, (None,))
    if not len(times):
        raise FormatError(f"{file.path}: {name} is empty; at least one time is needed")
    decreasing = np.flatnonzero(np.diff(times) <= 0)
    if len(decreasing) and not (of_curve and is_increasing(times)):
        row = int(decreasing[0]) + 1
        raise FormatError(
            f"{file.path}: {name} does not increase in row {row}: {times[row]:g} s after {times[row - 1]:g} s"
        )
    return times


def _read_array(
    file: Contents, name: str, shape: tuple[int | None, ...], kind: Literal["integers", "floats"]
) -> NDArray[Any]:
    if name not in file.arrays:
        raise FormatError(f"{file.path}: {name} is missing; it is damaged")
    array = file.arrays[name]
    fits = len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in _DTYPE_KINDS[kind]:
        lengths = ", ".join("any" if n is None else str(n) for n in shape)
        raise FormatError(
            f"{file.path}: {name} is {array.dtype} of shape {array.shape}; {kind} of shape ({lengths}) are expected"
        )
    return array


def read_scale(file: Contents) -> float:
    """Read the scale of a shape space, which is the length of its unit."""
    scale = float(file.attributes["space"]["scale"])
    if not MIN_LENGTH <= scale <= MAX_LENGTH:
        raise FormatError(
            f"{file.path}: the scale of the space is {scale:g}; "
            f"a number from {MIN_LENGTH:g} to {MAX_LENGTH:g} is expected"
        )
    return scale


def read_settings(file: Contents, group: str, names: Collection[str]) -> dict[str, Any]:
    """Read a group of settings, which must have exactly the names `names`."""
    settings: dict[str, Any] = json.loads(file.text("settings"))[group]
    if differing := sorted(set(settings) ^ set(names)):
        raise FormatError(f"{file.path}: the setting {differing[0]!r} is missing or not known; it is damaged")
    return settings
