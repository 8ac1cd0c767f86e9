"""Arrays in npz files, whose size is compared with the limit of memory before anything is unpacked.

A small zip file can unpack to any size, and its headers can lie. The archive's size of an array must match its shape,
and all arrays read at once must fit the limit. Compression methods that NumPy does not write are refused, since their
unpacking is unbounded.

Specification: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from math import prod
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq_io.memory import check_memory
from mixseq_io.reader import reading

_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    SyntaxError,
    TokenError,
    RuntimeError,
    OverflowError,
    struct.error,
)
"""Exceptions of zipfile, zlib and numpy for damaged input."""

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


class ArrayHeader(NamedTuple):
    """Header of an array: its shape, whether it is in Fortran order, and its dtype."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]


class Archive:
    """An open npz file."""

    def __init__(self, path: Path, file: zipfile.ZipFile) -> None:
        self._path = path
        self._file = file
        self._sizes: dict[str, int] = {}
        self.names = dict.fromkeys(name.removesuffix(".npy") for name in file.namelist()).keys()

    def read(self, name: str) -> NDArray[Any]:
        """Return an array; with those read before, it must fit the limit of memory."""
        with self.open(name) as (stream, _):
            self._sizes[name] = self._file.getinfo(f"{name}.npy").file_size
            check_memory(self._path, sum(self._sizes.values()), f"its arrays, with {name!r},")
        with self._file.open(f"{name}.npy") as stream:
            array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
            finish(stream)
            return array

    @contextmanager
    def open(self, name: str) -> Iterator[tuple[IO[bytes], ArrayHeader]]:
        """Yield a stream of an array's numbers, and its header."""
        member = self._file.getinfo(f"{name}.npy")
        if member.compress_type not in _METHODS:
            raise FormatError(
                f"{self._path}: {name} is compressed by method {member.compress_type}, which NumPy does not write; "
                "save it anew with numpy.savez"
            )
        with self._file.open(member) as stream:
            header = self._header(name, stream)
            if header.dtype.hasobject:
                raise ValueError(f"{name} has Python objects, which are not read")
            if stream.tell() + prod(header.shape) * header.dtype.itemsize != member.file_size:
                raise FormatError(
                    f"{self._path}: {name} of shape {header.shape} do not fill their {member.file_size} bytes; it is "
                    "damaged"
                )
            yield stream, header

    def _header(self, name: str, stream: IO[bytes]) -> ArrayHeader:
        version = npy.read_magic(stream)
        if version == (1, 0):
            return ArrayHeader(*npy.read_array_header_1_0(stream))
        if version == (2, 0):
            return ArrayHeader(*npy.read_array_header_2_0(stream))
        raise FormatError(
            f"{self._path}: {name} are stored in npy version {version}; 1.0 and 2.0 can be read"
        )


def finish(stream: IO[bytes]) -> None:
    """Read an array's stream to the end, where zipfile compares the checksum."""
    stream.read(1)


@contextmanager
def opened_archive(path: Path) -> Iterator[Archive]:
    """Open an npz file."""
    with reading_archive(path), zipfile.ZipFile(path) as file:
        yield Archive(path, file)


def reading_archive(path: Path) -> AbstractContextManager[None]:
    """Translate errors of zipfile and NumPy on damaged files into `FormatError`."""
    return reading(path, "an npz file", *_DAMAGE)
