"""Read and write NumPy archives (zip files of arrays) in blocks of frames; pickled arrays are rejected.

A small zip file can unpack to any size, and its headers can be wrong. The stored size of an array must match its shape,
and all arrays that are read at once must fit the memory limit. Compression methods that NumPy does not write are
rejected, since the memory for unpacking them is not limited.

Specification: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html and ``docs/formats.md``
"""

from __future__ import annotations

import shutil
import struct
import sys
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from math import prod
from pathlib import Path
from tempfile import SpooledTemporaryFile
from tokenize import TokenError
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.runtime.text_files import decode_text
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import Float, FloatArray
from mixseq_io.files import atomic_file, check_memory, memory_limit
from mixseq_io.reader import (
    DamageError,
    SequenceReader,
    prefix_errors,
    read_bytes,
    translate_read_errors,
    validate_blocks,
    warn,
)
from mixseq_io.surfaces import SURFACE_ARRAY_NAMES, surface_from_arrays, surface_to_arrays

_DAMAGE_ERRORS = (
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
"""Exceptions that zipfile, zlib and NumPy raise for damaged files."""

_COMPRESSION_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_HEADER_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


class ArrayHeader(NamedTuple):
    """Header of an array in an archive."""

    shape: tuple[int, ...]
    is_fortran: bool
    dtype: np.dtype[Any]


class Archive:
    """An open npz file."""

    def __init__(self, path: Path, file: zipfile.ZipFile) -> None:
        self._path = path
        self._file = file
        self._sizes: dict[str, int] = {}
        self.names = dict.fromkeys(name.removesuffix(".npy") for name in file.namelist()).keys()

    def read(self, name: str) -> NDArray[Any]:
        """Read an array; this array and the previously read arrays must together fit the memory limit."""
        with self.open(name) as (stream, _):
            self._sizes[name] = self._file.getinfo(f"{name}.npy").file_size
            check_memory(self._path, sum(self._sizes.values()), f"its arrays, with {name!r},")
        with self._file.open(f"{name}.npy") as stream:
            array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
            stream.read(1)  # at the end zipfile compares the checksum
        if array.dtype.kind == "U" and array.nbytes:
            characters = np.frombuffer(array.tobytes(), f"{array.dtype.str[0]}u4")
            if characters.max() > sys.maxunicode:
                raise DamageError(f"{name} has characters that do not exist")
        return array

    @contextmanager
    def open(self, name: str) -> Iterator[tuple[IO[bytes], ArrayHeader]]:
        """Yield a stream of an array's data, and its header."""
        member = self._file.getinfo(f"{name}.npy")
        if member.compress_type not in _COMPRESSION_METHODS:
            raise FormatError(
                f"{self._path}: {name} is compressed by method {member.compress_type}, which NumPy does not write; "
                "save it again with numpy.savez"
            )
        with self._file.open(member) as stream:
            version = npy.read_magic(stream)
            if version not in _HEADER_READERS:
                raise FormatError(f"{self._path}: {name} have npy version {version}; 1.0 and 2.0 can be read")
            header = ArrayHeader(*_HEADER_READERS[version](stream))
            if header.dtype.hasobject:
                raise DamageError(f"{name} has Python objects, which are not read")
            if stream.tell() + prod(header.shape) * header.dtype.itemsize != member.file_size:
                raise FormatError(
                    f"{self._path}: {name} of shape {header.shape} do not fill their {member.file_size} bytes; it is "
                    "damaged"
                )
            yield stream, header


@contextmanager
def open_archive(path: Path) -> Iterator[Archive]:
    """Open an npz file."""
    with translate_archive_errors(path), zipfile.ZipFile(path) as file:
        yield Archive(path, file)


def translate_archive_errors(path: Path) -> AbstractContextManager[None]:
    """Translate errors of zipfile and NumPy about damaged files into `FormatError`."""
    return translate_read_errors(path, "an npz file", *_DAMAGE_ERRORS)


def read_values(path: Path) -> Float:
    """Read numbers: the array ``values`` or the only one of an .npz file, an .npy file, or text with a row per line."""
    suffix = path.suffix.lower()
    with translate_read_errors(path, "numbers of vertices (.npy, .npz or text)", *_DAMAGE_ERRORS):
        if suffix == ".npz":
            with open_archive(path) as archive:
                name = "values" if "values" in archive.names or len(archive.names) != 1 else next(iter(archive.names))
                numbers = archive.read(name)
        elif suffix == ".npy":
            numbers = np.load(path, mmap_mode="r", allow_pickle=False)
        else:
            text = decode_text(path, read_bytes(path, text=True), "numbers of vertices")
            numbers = np.array([line.split() for line in text.replace(",", " ").splitlines() if line.strip()], float)
        return np.asarray(numbers, dtype=np.float64).squeeze()


_MAX_SPOOLED_BYTES = 1 << 26
_COPY_CHUNK_BYTES = 1 << 20


def open_npz(path: Path, fps: float | None = None) -> SequenceReader:
    """Open an npz file."""
    with ExitStack() as stack, translate_archive_errors(path):
        archive = Archive(path, stack.enter_context(zipfile.ZipFile(path)))
        members = archive.names
        if "points" not in members or not ("faces" in members or {"face_counts", "face_indices"} <= members):
            raise FormatError(
                f"{path} has the arrays {', '.join(sorted(members)) or 'none'}; `points`, and `faces` or "
                "`face_counts` with `face_indices`, are needed"
            )
        arrays = {name: archive.read(name) for name in _SMALL_ARRAYS if name in members}
        with archive.open("points") as (_, array_header):
            shape = _check_number_type(path, "points", array_header)
        with prefix_errors(path):
            header = _sequence_header(path, shape, arrays, fps)
        has_velocities = "velocities" in members and _has_velocities(path, archive, shape)
        return _NpzReader(path, header, archive, stack.pop_all(), has_velocities)


_FACE_ARRAYS = ("faces", "face_counts", "face_indices")
_SMALL_ARRAYS = (*_FACE_ARRAYS, "fps", "times", "up_axis", "metres_per_unit", "name", *SURFACE_ARRAY_NAMES)


class _NpzReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, archive: Archive, stack: ExitStack, has_velocities: bool
    ) -> None:
        super().__init__(path, header, stack, has_velocities)
        self._archive = archive

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        with translate_archive_errors(self.path), self._archive.open(what) as (stream, header):
            frames = header.shape[0]
            if header.is_fortran:  # frames are not contiguous in the file
                with memory_limit(self._memory_limit):
                    array = _as_floats(self._archive.read(what))
                yield from (array[start : start + size] for start in range(0, frames, size))
                return
            for start in range(0, frames, size):
                block = np.empty((min(size, frames - start), *header.shape[1:]), header.dtype)
                for frame in block:  # zipfile raises an error if the data ends early
                    frame[...] = np.frombuffer(stream.read(frame.nbytes), frame.dtype).reshape(frame.shape)
                if start + size >= frames:
                    stream.read(1)  # at the end zipfile compares the checksum
                yield _as_floats(block)


def _sequence_header(
    path: Path, shape: tuple[int, ...], arrays: dict[str, NDArray[Any]], fps: float | None
) -> SequenceHeader:
    if len(shape) != 3 or shape[2] != 3:
        raise FormatError(f"{path}: points have shape {shape}; (frames, vertices, 3) is expected")
    if "face_counts" in arrays and "face_indices" in arrays:
        polygons = Polygons(arrays["face_counts"], arrays["face_indices"])
    else:
        faces = arrays["faces"]
        if faces.ndim != 2 or faces.shape[1] < 3:
            raise FormatError(f"{path}: faces have shape {faces.shape}; (faces, 3) is expected")
        polygons = Polygons(np.full(len(faces), faces.shape[1]), faces.reshape(-1))
    rate = float(arrays["fps"].item()) if "fps" in arrays else fps if fps is not None else DEFAULT_FPS
    # The header reports invalid rates, which must not be used as divisors here.
    rate = rate if "times" in arrays else snap_to_ntsc(rate)
    times = arrays["times"] if "times" in arrays else np.arange(shape[0]) / (rate if rate > 0 else 1.0)
    if np.size(times) != shape[0]:
        raise FormatError(f"{path}: {shape[0]} frames of points for {np.size(times)} times; it is damaged")
    return SequenceHeader(
        polygons=polygons,
        vertex_count=shape[1],
        times=times,
        fps=rate,
        up_axis=str(arrays["up_axis"].item()) if "up_axis" in arrays else "Y",
        metres_per_unit=float(arrays["metres_per_unit"].item()) if "metres_per_unit" in arrays else 1.0,
        name=str(arrays["name"].item()) if "name" in arrays else path.stem,
        surface=surface_from_arrays(arrays, path.parent),
    )


def _check_number_type(path: Path, name: str, header: ArrayHeader) -> tuple[int, ...]:
    """Return the shape of an array of numbers; raise an error for other types."""
    if not (np.issubdtype(header.dtype, np.floating) or np.issubdtype(header.dtype, np.integer)):
        raise FormatError(f"{path}: {name} have type {header.dtype}; numbers are expected")
    return header.shape


def _has_velocities(path: Path, archive: Archive, shape: tuple[int, ...]) -> bool:
    """Whether there is a velocity for every point; archives of other programs may lack velocities."""
    with archive.open("velocities") as (_, header):
        velocities_shape = _check_number_type(path, "velocities", header)
    if velocities_shape != shape:
        warn(f"{path}: velocities have shape {velocities_shape}, points {shape}; they are left out")
    return velocities_shape == shape


def _as_floats(points: NDArray[Any]) -> FloatArray:
    """Return points of native float32 unchanged, and other types as float64."""
    is_single = points.dtype.kind == "f" and points.dtype.itemsize <= 4
    return points.astype(np.float32 if is_single else np.float64, copy=False)


def write_npz(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    compress: bool = False,
) -> None:
    """Write an npz file block by block."""
    arrays: dict[str, Any] = {
        "times": header.times,
        "fps": np.float64(header.fps),
        "up_axis": np.array(header.up_axis),
        "metres_per_unit": np.float64(header.metres_per_unit),
        "name": np.array(header.name),
    }
    if header.polygons.only_triangles:
        arrays["faces"] = header.faces
    else:
        arrays["face_counts"] = header.polygons.counts
        arrays["face_indices"] = header.polygons.indices
    arrays |= surface_to_arrays(header.surface)
    compression = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with atomic_file(path) as temporary, zipfile.ZipFile(temporary, "w", compression) as archive:
        dtype, frame_blocks = validate_blocks(header, blocks, velocities)
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as stream:
                npy.write_array(stream, np.asarray(array), allow_pickle=False)
        array_header = {
            "descr": npy.dtype_to_descr(dtype),
            "fortran_order": False,
            "shape": (header.frame_count, header.vertex_count, 3),
        }
        # Arrays are written successively, so velocities, which arrive with their points, are stored temporarily.
        with SpooledTemporaryFile(_MAX_SPOOLED_BYTES, dir=str(path.parent)) as spooled:
            with _open_array(archive, "points", array_header) as stream:
                for _, points, block_velocities in frame_blocks:
                    stream.write(points.data)
                    if block_velocities is not None:
                        spooled.write(block_velocities.data)
            if velocities is not None:
                spooled.seek(0)
                with _open_array(archive, "velocities", array_header) as stream:
                    shutil.copyfileobj(spooled, stream, _COPY_CHUNK_BYTES)


@contextmanager
def _open_array(archive: zipfile.ZipFile, name: str, header: dict[str, Any]) -> Iterator[IO[bytes]]:
    """Yield the stream to which the data of a large array is written."""
    # Without force_zip64 a member of unknown size may not grow beyond 2 GiB.
    with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
        npy.write_array_header_1_0(stream, header)
        yield stream
