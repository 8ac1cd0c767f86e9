"""NumPy archives: a zip file of arrays, read and written in blocks of frames; pickles are not read.

==================  ====================  =====================================================
array               shape                 meaning
==================  ====================  =====================================================
``points``          (T, V, 3) float       vertex positions, kept as float32 or float64
``velocities``      (T, V, 3) float       optional, units per second
``faces``           (F, K) int            triangles (K = 3) or other equal polygons; or instead
``face_counts``     (P,) int              number of corners of each polygon
``face_indices``    (sum of counts,) int  vertex of each corner
``fps``             float                 optional, 24
``times``           (T,) float            optional, seconds
``up_axis``         str                   optional, "X", "Y" or "Z"
``metres_per_unit`` float                 optional, 1
``name``            str                   optional, the file's name
==================  ====================  =====================================================

And those of `mixseq_io.surfaces`: texture coordinates, hard edges, face sets, objects.

A small zip file can unpack to any size, and its headers can lie. The archive's size of an array must match its shape,
and all arrays read at once must fit the limit. Compression methods that NumPy does not write are refused, since their
unpacking is unbounded.

Specification: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
"""

from __future__ import annotations

import shutil
import struct
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
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.files import atomic_file, check_memory, memory_limit
from mixseq_io.reader import SequenceReader, prefix_errors, translate_read_errors, validate_blocks, warn
from mixseq_io.surfaces import SURFACE_ARRAY_NAMES, surface_from_arrays, surface_to_arrays

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
            stream.read(1)  # at the end zipfile compares the checksum
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


@contextmanager
def open_archive(path: Path) -> Iterator[Archive]:
    """Open an npz file."""
    with reading_archive(path), zipfile.ZipFile(path) as file:
        yield Archive(path, file)


def reading_archive(path: Path) -> AbstractContextManager[None]:
    """Translate errors of zipfile and NumPy on damaged files into `FormatError`."""
    return translate_read_errors(path, "an npz file", *_DAMAGE)


_MOST_IN_MEMORY = 1 << 26
_COPIED_AT_ONCE = 1 << 20


def open_npz(path: Path, fps: float | None = None) -> SequenceReader:
    """Open an npz file."""
    with ExitStack() as resources, reading_archive(path):
        archive = Archive(path, resources.enter_context(zipfile.ZipFile(path)))
        members = archive.names
        if "points" not in members or not ("faces" in members or {"face_counts", "face_indices"} <= members):
            raise FormatError(
                f"{path} has the arrays {', '.join(sorted(members)) or 'none'}; `points`, and `faces` or "
                "`face_counts` with `face_indices`, are needed"
            )
        small = {name: archive.read(name) for name in (*_SMALL, *SURFACE_ARRAY_NAMES) if name in members}
        with archive.open("points") as (_, start):
            shape = _large_array(path, "points", start)
        with prefix_errors(path):
            header = _header(path, shape, small, fps)
        moving = "velocities" in members and _fit(path, archive, shape)
        return _NpzReader(path, header, archive, resources.pop_all(), moving)


_SMALL = ("faces", "face_counts", "face_indices", "fps", "times", "up_axis", "metres_per_unit", "name")


class _NpzReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, archive: Archive, resources: ExitStack, moving: bool
    ) -> None:
        super().__init__(path, header, resources, moving)
        self._archive = archive

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        with reading_archive(self.path), self._archive.open(what) as (stream, header):
            frames = header.shape[0]
            if header.fortran:  # a frame's numbers are all over the file: there is nothing to stream
                with memory_limit(self._memory_limit):
                    whole = _as_floats(self._archive.read(what))
                yield from (whole[start : start + size] for start in range(0, frames, size))
                return
            for start in range(0, frames, size):
                block = np.empty((min(size, frames - start), *header.shape[1:]), header.dtype)
                _read_into(stream, block)
                if start + size >= frames:
                    stream.read(1)  # at the end zipfile compares the checksum
                yield _as_floats(block)


def _header(
    path: Path, shape: tuple[int, ...], small: dict[str, NDArray[Any]], fps: float | None
) -> SequenceHeader:
    if len(shape) != 3 or shape[2] != 3:
        raise FormatError(f"{path}: points have shape {shape}; (frames, vertices, 3) is expected")
    if "face_counts" in small and "face_indices" in small:
        polygons = Polygons(small["face_counts"], small["face_indices"])
    else:
        faces = small["faces"]
        if faces.ndim != 2 or faces.shape[1] < 3:
            raise FormatError(f"{path}: faces have shape {faces.shape}; (faces, 3) is expected")
        polygons = Polygons(np.full(len(faces), faces.shape[1]), faces.reshape(-1))
    rate = float(small["fps"].item()) if "fps" in small else fps if fps is not None else DEFAULT_FPS
    # A rate that is no rate is reported by the header; dividing by it here must not be an error of its own.
    rate = rate if "times" in small else snap_to_ntsc(rate)
    times = small["times"] if "times" in small else np.arange(shape[0]) / (rate if rate > 0 else 1.0)
    if np.size(times) != shape[0]:
        raise FormatError(f"{path}: {shape[0]} frames of points for {np.size(times)} times; it is damaged")
    return SequenceHeader(
        polygons=polygons,
        vertex_count=shape[1],
        times=times,
        fps=rate,
        up_axis=str(small["up_axis"].item()) if "up_axis" in small else "Y",
        metres_per_unit=float(small["metres_per_unit"].item()) if "metres_per_unit" in small else 1.0,
        name=str(small["name"].item()) if "name" in small else path.stem,
        surface=surface_from_arrays(small, path.parent),
    )


def _large_array(path: Path, name: str, header: ArrayHeader) -> tuple[int, ...]:
    """Return the shape of an array that is read in blocks."""
    if not (np.issubdtype(header.dtype, np.floating) or np.issubdtype(header.dtype, np.integer)):
        raise FormatError(f"{path}: {name} have type {header.dtype}; numbers are expected")
    return header.shape


def _fit(path: Path, archive: Archive, shape: tuple[int, ...]) -> bool:
    """Whether there is a velocity for every point; archives of other programs may lack some."""
    with archive.open("velocities") as (_, start):
        found = _large_array(path, "velocities", start)
    if found != shape:
        warn(f"{path}: velocities have shape {found}, points {shape}; they are left out")
    return found == shape


def _read_into(stream: IO[bytes], block: NDArray[Any]) -> None:
    target = block.reshape(-1).view(np.uint8).data
    while target:
        chunk = stream.read(min(len(target), 1 << 24))
        if not chunk:
            raise EOFError("an array ends early")
        target[: len(chunk)] = chunk
        target = target[len(chunk) :]


def _as_floats(points: NDArray[Any]) -> FloatArray:
    """Return native float32 unchanged, other types as float64."""
    kept = points.dtype.kind == "f" and points.dtype.itemsize <= 4
    return points.astype(np.float32 if kept else np.float64, copy=False)


def write_npz(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    compress: bool = False,
) -> None:
    """Write an npz file, one block at a time."""
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
    method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with atomic_file(path) as temporary, zipfile.ZipFile(temporary, "w", method) as archive:
        dtype, numbered = validate_blocks(header, blocks, velocities)
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as stream:
                npy.write_array(stream, np.asarray(array), allow_pickle=False)
        start = {
            "descr": npy.dtype_to_descr(dtype),
            "fortran_order": False,
            "shape": (header.frame_count, header.vertex_count, 3),
        }
        # An archive takes one array after the other: velocities, which come with their points, wait aside.
        with SpooledTemporaryFile(_MOST_IN_MEMORY, dir=str(path.parent)) as aside:
            with _array(archive, "points", start) as stream:
                for _, points, speeds in numbered:
                    stream.write(points.data)
                    if speeds is not None:
                        aside.write(speeds.data)
            if velocities is not None:
                aside.seek(0)
                with _array(archive, "velocities", start) as stream:
                    shutil.copyfileobj(aside, stream, _COPIED_AT_ONCE)


@contextmanager
def _array(archive: zipfile.ZipFile, name: str, start: dict[str, Any]) -> Iterator[IO[bytes]]:
    """Yield the stream for the numbers of a large array with the header `start`."""
    # Without force_zip64 a member of unknown size may not grow beyond 2 GiB.
    with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
        npy.write_array_header_1_0(stream, start)
        yield stream
