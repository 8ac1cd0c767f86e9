"""HDF5 files written with Fletcher-32 checksums of datasets, and those of the HDF5 1.10 layout for the structure.

Specification: https://support.hdfgroup.org/documentation/hdf5/latest/_f_m_t3.html
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mixseq.interrupts import unbroken
from mixseq.sequence import SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.surface_arrays import surface_arrays

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
    for name, array in surface_arrays(header.surface).items():
        if array.dtype.kind == "U":
            # Fixed length: strings of any length lie outside the dataset and its checksum.
            array = np.char.encode(array, "utf-8")
        put_array(file, f"surface/{name}", array)


@contextmanager
def creating_h5(path: Path) -> Iterator[tuple[h5py.File, Store]]:
    """Yield a new HDF5 file that replaces `path` when complete, and the store that reports failures."""
    with replacing(path) as temporary, temporary.open("w+b", buffering=0) as raw:
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

    @unbroken
    def write(self, data: memoryview) -> int:
        """Write all of the data."""
        try:
            rest = memoryview(data)
            while rest and self._failure is None:
                rest = rest[self._file.write(rest) :]
        except BaseException as error:
            self._failure = error
        return len(data)

    @unbroken
    def truncate(self, size: int) -> int:
        """Set the file's size."""
        try:
            if self._failure is None:
                return self._file.truncate(size)
        except BaseException as error:
            self._failure = error
        return size

    @unbroken
    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a byte."""
        return self._file.seek(offset, whence)

    @unbroken
    def tell(self) -> int:
        """Return the current byte."""
        return self._file.tell()

    @unbroken
    def read(self, size: int = -1) -> bytes:
        """Read bytes."""
        return self._file.read(size)

    @unbroken
    def flush(self) -> None:
        """Do nothing: the file is unbuffered, and flushed to disk before it gets its name."""
