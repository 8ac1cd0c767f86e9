"""Arrays and settings in HDF5: written with checksums, read with checks of kind, shape and range.

Datasets have Fletcher-32 checksums, and the structure those of the HDF5 1.10 layout.

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

from mixseq.errors import FormatError
from mixseq.runtime.interrupts import uninterrupted
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MAX_LENGTH, MIN_LENGTH
from mixseq.types import Float, Index
from mixseq_io.files import atomic_file
from mixseq_io.hdf5.contents import Contents
from mixseq_io.surfaces import surface_to_arrays

CHECKED: dict[str, Any] = {"fletcher32": True, "shuffle": True, "compression": "gzip", "compression_opts": 6}
"""Storage options of every dataset with elements."""

_CHUNK_ROWS = 64
_CHUNK_COLUMNS = 2048
"""Columns per chunk: few, so that gzip's window of 32 KiB covers similar rows."""


def put_text(holder: h5py.Group, name: str, text: str) -> None:
    """Store a text as an attribute of fixed length, since variable-length strings have no checksum."""
    data = text.encode("utf-8", "surrogateescape")
    holder.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", max(1, len(data))))


def put_array(file: h5py.File, name: str, array: NDArray[Any]) -> None:
    """Store an array in chunks of at most 1 MiB, and write it at once, so that equal contents give equal files.

    HDF5 otherwise allocates the numbers when the last reference goes; debuggers and dask's profiler may hold one.
    """
    file.create_dataset(
        name, data=array, **(CHECKED | {"chunks": _chunks(array.shape)} if array.size else {})
    )
    file.flush()


def _chunks(shape: tuple[int, ...]) -> tuple[int, ...]:
    if len(shape) == 1:
        return (min(shape[0], _CHUNK_ROWS * _CHUNK_COLUMNS),)
    count, columns, *rest = shape
    return (min(count, _CHUNK_ROWS), min(columns, max(1, _CHUNK_COLUMNS // prod(rest))), *rest)


def write_header(file: h5py.File, header: SequenceHeader) -> None:
    """Store a sequence's header except for its times."""
    put_text(file, "name", header.name)
    file.attrs["fps"] = header.fps
    put_text(file, "up_axis", header.up_axis)
    file.attrs["metres_per_unit"] = header.metres_per_unit
    put_array(file, "polygons/counts", header.polygons.counts)
    put_array(file, "polygons/indices", header.polygons.indices)
    for name, array in surface_to_arrays(header.surface).items():
        if array.dtype.kind == "U":
            # Fixed length: strings of any length lie outside the dataset and its checksum.
            array = np.char.encode(array, "utf-8")
        put_array(file, f"surface/{name}", array)


@contextmanager
def creating_h5(path: Path) -> Iterator[tuple[h5py.File, Store]]:
    """Yield a new HDF5 file that replaces `path` when complete, and the store that reports failures."""
    with atomic_file(path) as temporary, temporary.open("w+b", buffering=0) as raw:
        store = Store(raw)
        with h5py.File(store, "w", libver=("v110", "v110")) as file:
            yield file, store
        store.check()


class Store:
    """File object for HDF5 that accepts all writes and reports failures afterwards.

    HDF5 cannot close a file after a failed write, and crashes later; nor can it pass on exceptions of Python callbacks.
    The first failure is kept for `check`, later writes are dropped, and signals wait.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._failure: BaseException | None = None

    def check(self) -> None:
        """Raise the first failure, if any."""
        if self._failure is not None:
            raise self._failure

    @uninterrupted
    def write(self, data: memoryview) -> int:
        """Write all of the data."""
        try:
            rest = memoryview(data)
            while rest and self._failure is None:
                rest = rest[self._file.write(rest) :]
        except BaseException as error:
            self._failure = error
        return len(data)

    @uninterrupted
    def truncate(self, size: int) -> int:
        """Set the file's size."""
        try:
            if self._failure is None:
                return self._file.truncate(size)
        except BaseException as error:
            self._failure = error
        return size

    @uninterrupted
    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a byte."""
        return self._file.seek(offset, whence)

    @uninterrupted
    def tell(self) -> int:
        """Return the current byte."""
        return self._file.tell()

    @uninterrupted
    def read(self, size: int = -1) -> bytes:
        """Read bytes."""
        return self._file.read(size)

    @uninterrupted
    def flush(self) -> None:
        """Do nothing: the file is unbuffered, and flushed to disk before it gets its name."""


_LARGEST = 1e20
"""Largest magnitude of valid numbers; products of several are still finite."""

_KINDS = {"integers": "iu", "floats": "f"}  # as NumPy names them


def put(file: h5py.File, name: str, array: NDArray[Any]) -> None:
    """Store an array, in single precision if that suffices."""
    if array.dtype == np.float64 and array.size:
        with np.errstate(over="ignore"):
            single = array.astype(np.float32)
        array = single if np.array_equal(single, array) else array
    put_array(file, name, array)


def put_lists(file: h5py.File, group: str, name: str, lists: Sequence[NDArray[Any]]) -> None:
    """Store lists of indices as `put_joined`."""
    put_joined(file, group, name, np.array(list(map(len, lists))), np.concatenate([*lists, np.zeros(0)]))


def put_joined(
    file: h5py.File, group: str, name: str, sizes: NDArray[np.integer], items: NDArray[Any]
) -> None:
    """Store lists of indices by their lengths and their concatenation."""
    put(file, f"{group}/sizes", sizes.astype(np.int32))
    put(file, f"{group}/{name}", items.astype(np.int32))


def get_lists(path: Path, file: Contents, group: str, name: str, limit: int) -> list[Index]:
    """Read lists of indices below `limit` that `put_lists` stored."""
    sizes, items = get_joined(path, file, group, name, limit)
    return np.split(items, np.cumsum(sizes))[: len(sizes)]


def get_joined(path: Path, file: Contents, group: str, name: str, limit: int) -> tuple[Index, Index]:
    """Read the lengths of non-empty lists, and their concatenation."""
    sizes = integers(path, file, f"{group}/sizes", (None,), 1)
    return sizes, integers(path, file, f"{group}/{name}", (int(sizes.sum()),), 0, limit)


def integers(
    path: Path, file: Contents, name: str, shape: tuple[int | None, ...], low: int, limit: int | None = None
) -> Index:
    """Read integers from `low` to below `limit`; None in the shape allows any length."""
    array = _of_kind(path, file, name, shape, "integers")
    if array.size and (array.min() < low or (limit is not None and array.max() >= limit)):
        upper = "" if limit is None else f" to {limit - 1}"
        raise FormatError(f"{path}: {name} has values outside {low}{upper}; it is damaged")
    return array.astype(np.int64)


def floats(path: Path, file: Contents, name: str, shape: tuple[int | None, ...]) -> Float:
    """Read finite numbers of valid magnitude; None in the shape allows any length."""
    array = _finite(path, file, name, shape)
    if array.size and (large := np.abs(array)).max() > MAX_LENGTH:
        row = np.argwhere(large > MAX_LENGTH)[0, 0]
        raise FormatError(
            f"{path}: {name} has {large.max():g} in row {row}, beyond {MAX_LENGTH:g}; it is damaged"
        )
    return array


def _finite(path: Path, file: Contents, name: str, shape: tuple[int | None, ...]) -> Float:
    array = _of_kind(path, file, name, shape, "floats")
    if not np.isfinite(array).all():
        raise FormatError(f"{path}: {name} is not finite in row {np.argwhere(~np.isfinite(array))[0, 0]}")
    return array.astype(np.float64)


def diagonals(path: Path, file: Contents, name: str, shape: tuple[int | None, ...]) -> Float:
    """Read lengths or positions in diagonals: numbers as of `floats`, of plausible size."""
    array = _finite(path, file, name, shape)
    if array.size and np.abs(array).max() > _LARGEST:
        row = np.argwhere(np.abs(array) > _LARGEST)[0, 0]
        raise FormatError(f"{path}: {name} is above {_LARGEST:g} diagonals in row {row}; it is damaged")
    return array


def increasing(path: Path, file: Contents, name: str) -> Float:
    """Read at least one increasing time ``(n,)``."""
    times = floats(path, file, name, (None,))
    if not len(times):
        raise FormatError(f"{path}: {name} is empty; at least one time is needed")
    back = np.flatnonzero(np.diff(times) <= 0)
    if len(back):
        row = int(back[0]) + 1
        raise FormatError(
            f"{path}: {name} does not increase in row {row}: {times[row]:g} s after {times[row - 1]:g} s"
        )
    return times


def _of_kind(
    path: Path, file: Contents, name: str, shape: tuple[int | None, ...], kind: Literal["integers", "floats"]
) -> NDArray[Any]:
    if name not in file.arrays:
        raise FormatError(f"{path}: {name} is missing; it is damaged")
    array = file.arrays[name]
    fits = len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in _KINDS[kind]:
        lengths = ", ".join("any" if n is None else str(n) for n in shape)
        raise FormatError(
            f"{path}: {name} is {array.dtype} of shape {array.shape}; {kind} of shape ({lengths}) are expected"
        )
    return array


def read_scale(path: Path, file: Contents) -> float:
    """Read the length of the space's unit."""
    scale = float(file.attributes["space"]["scale"])
    if not MIN_LENGTH <= scale <= MAX_LENGTH:
        raise FormatError(
            f"{path}: the scale of the space is {scale:g}; a number from {MIN_LENGTH:g} to {MAX_LENGTH:g} is expected"
        )
    return scale


def read_settings(path: Path, file: Contents, about: str, known: Collection[str]) -> dict[str, Any]:
    """Read all settings of a group."""
    found: dict[str, Any] = json.loads(file.text("settings"))[about]
    others = sorted(set(found) ^ set(known))
    if others:
        raise FormatError(f"{path}: the setting {others[0]!r} is missing or not known; it is damaged")
    return found
