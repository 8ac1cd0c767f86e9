"""NumPy archives: a zip file of arrays, read and written without ever holding all frames.

==================  ====================  =====================================================
array               shape                 meaning
==================  ====================  =====================================================
``points``          (T, V, 3) float       vertex positions
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

and those of `mixseq_io.surface_arrays`: texture coordinates, hard edges, face sets, objects.
Points keep their precision, float32 or float64. Objects (pickles) are not read.

Specifications: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html and
https://pkware.cachefly.net/webdocs/casestudies/APPNOTE.TXT
"""

from __future__ import annotations

import shutil
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from lzma import LZMAError
from math import prod
from pathlib import Path
from tempfile import SpooledTemporaryFile
from tokenize import TokenError
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError
from mixseq.sequence import DEFAULT_FPS, Polygons, SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.blocks import checked, warn
from mixseq_io.reader import SequenceReader, naming, reading
from mixseq_io.surface_arrays import SURFACE_ARRAYS, surface_arrays, surface_of_arrays

DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    LZMAError,
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
"""What zipfile, zlib and numpy raise at damaged input."""

_MOST_IN_MEMORY = 1 << 26
_COPIED_AT_ONCE = 1 << 20


def open_npz(path: Path, fps: float | None = None) -> SequenceReader:
    """Open an npz file.

    Parameters
    ----------
    path : Path
        The file.
    fps : float, optional
        Frames per second if the file tells neither fps nor times.
    """
    with ExitStack() as resources, reading(path, "an npz file", *DAMAGE):
        archive = resources.enter_context(zipfile.ZipFile(path))
        members = {name.removesuffix(".npy") for name in archive.namelist()}
        if "points" not in members or not ("faces" in members or {"face_counts", "face_indices"} <= members):
            raise FormatError(
                f"{path} has the arrays {', '.join(sorted(members)) or 'none'}; `points`, and `faces` or "
                "`face_counts` with `face_indices`, are needed"
            )
        small = {name: _read_array(archive, name) for name in (*_SMALL, *SURFACE_ARRAYS) if name in members}
        with archive.open("points.npy") as stream:
            shape, _, _ = _read_array_header(path, stream, archive.getinfo("points.npy").file_size)
        with naming(path):
            header = _header(path, shape, small, fps)
        moving = "velocities" in members and _fit(path, archive, shape)
        return _NpzReader(path, header, archive, resources.pop_all(), moving)


_SMALL = ("faces", "face_counts", "face_indices", "fps", "times", "up_axis", "metres_per_unit", "name")


class _NpzReader(SequenceReader):
    def __init__(
        self, path: Path, header: SequenceHeader, archive: zipfile.ZipFile, resources: ExitStack, moving: bool
    ) -> None:
        super().__init__(path, header, resources, moving)
        self._archive = archive

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        return self._read("points", size)

    def _read_velocities(self, size: int) -> Iterator[FloatArray]:
        return self._read("velocities", size)

    def _read(self, name: str, size: int) -> Iterator[FloatArray]:
        member = f"{name}.npy"
        with reading(self.path, "an npz file", *DAMAGE), self._archive.open(member) as stream:
            shape, fortran, dtype = _read_array_header(
                self.path, stream, self._archive.getinfo(member).file_size, name
            )
            if fortran:  # a frame's numbers are all over the file: there is nothing to stream
                whole = _as_floats(_read_array(self._archive, name))
                yield from (whole[start : start + size] for start in range(0, len(whole), size))
                return
            for start in range(0, shape[0], size):
                block = np.empty((min(size, shape[0] - start), *shape[1:]), dtype)
                _read_into(stream, block)
                if start + size >= shape[0]:
                    stream.read(1)  # zipfile compares the checksum when it meets the end
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
        surface=surface_of_arrays(small, path.parent),
    )


def _read_array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    with archive.open(f"{name}.npy") as stream:
        array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
        stream.read(1)
        return array


def _read_array_header(
    path: Path, stream: IO[bytes], member_size: int, name: str = "points"
) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read the header of a large array, and check that as many bytes follow as it announces."""
    version = npy.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = npy.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, fortran, dtype = npy.read_array_header_2_0(stream)
    else:
        raise FormatError(f"{path}: {name} are stored in npy version {version}; 1.0 and 2.0 can be read")
    if not (np.issubdtype(dtype, np.floating) or np.issubdtype(dtype, np.integer)):
        raise FormatError(f"{path}: {name} have type {dtype}; numbers are expected")
    if stream.tell() + prod(shape) * dtype.itemsize != member_size:
        raise FormatError(
            f"{path}: {name} of shape {shape} do not fill their {member_size} bytes; it is damaged"
        )
    return shape, fortran, dtype


def _fit(path: Path, archive: zipfile.ZipFile, shape: tuple[int, ...]) -> bool:
    """Whether there is a velocity for every point; in archives that others made there may not be."""
    size = archive.getinfo("velocities.npy").file_size
    with archive.open("velocities.npy") as stream:
        found, _, _ = _read_array_header(path, stream, size, "velocities")
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
    """Return native float32 as it is, everything else as float64."""
    kept = points.dtype.kind == "f" and points.dtype.itemsize <= 4
    return points.astype(np.float32 if kept else np.float64, copy=False)


def write_npz(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
    compress: bool = False,
) -> None:
    """Write an npz file, one block at a time.

    Parameters
    ----------
    path, header, blocks, velocities
        See `mixseq_io.write_blocks`.
    compress : bool
        Deflate the arrays.
    """
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
    arrays |= surface_arrays(header.surface)
    method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", method) as archive:
        dtype, numbered = checked(header, blocks, velocities)
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
    """Yield what takes the numbers of a large array that begins with the header `start`."""
    # Without force_zip64 a member of unknown size may not grow beyond 2 GiB.
    with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
        npy.write_array_header_1_0(stream, start)
        yield stream
