"""HDF5 sequences: everything a mesh sequence has, compressed, with a checksum for every piece.

::

    /                    format = "mixseq-sequence", version = 1,
                         name, fps, up_axis, metres_per_unit
    /points              (T, V, 3) float32 or float64, in chunks of whole frames
    /times               (T,) float64, seconds
    /polygons/counts     (P,) int32
    /polygons/indices    (sum of counts,) int32

Every dataset has Fletcher-32 checksums, and the file's own structure has checksums too (the HDF5 1.10
layout), so that damage is noticed where it happened.

A file of `format` "mixseq-model" holds a shape space instead; it is sampled at the times it was made from.

Specification: https://support.hdfgroup.org/documentation/hdf5/latest/_f_m_t3.html
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.sequence import FloatArray, MeshSequence, Polygons, SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.blocks import checked
from mixseq_io.reader import MemoryReader, SequenceReader, brief, naming, reading

FORMAT = "mixseq-sequence"
MODEL_FORMAT = "mixseq-model"
VERSION = 1

# A chunk is compressed and read as a whole; HDF5 keeps 1 MiB of them by default.
_CHUNK_BYTES = 1 << 20
_CHECKED: dict[str, Any] = {"fletcher32": True, "shuffle": True, "compression": "gzip", "compression_opts": 4}


def open_h5(path: Path) -> SequenceReader:
    """Open a sequence, or sample a model, that mixseq stored in HDF5.

    Raises
    ------
    FormatError
        If the file is of another kind, damaged, or written by a newer mixseq.
    """
    with ExitStack() as resources, _reading(path):
        file = resources.enter_context(h5py.File(path, "r"))
        kind = file.attrs.get("format")
        if kind == MODEL_FORMAT:
            return MemoryReader(path, _sampled_model(path))
        if kind != FORMAT:
            raise FormatError(f"{path} is an HDF5 file, but not one of mixseq's (format = {kind!r})")
        version = int(file.attrs["version"])
        if version > VERSION:
            raise FormatError(
                f"{path} has version {version}, this mixseq reads up to {VERSION}; a newer mixseq wrote it: "
                "upgrade with pip install --upgrade mixseq"
            )
        with naming(path):
            header = _header(path, file)
        return _H5Reader(path, header, file, resources.pop_all())


def _reading(path: Path) -> AbstractContextManager[None]:
    return reading(path, "HDF5", KeyError, RuntimeError, ValueError, TypeError)


def _sampled_model(path: Path) -> MeshSequence:
    from mixseq_io.model_h5 import load  # models build on formats, not formats on models

    sequence: MeshSequence = load(path).sample()
    return sequence


def _header(path: Path, file: h5py.File) -> SequenceHeader:
    shape = file["points"].shape
    if len(shape) != 3 or shape[2] != 3 or file["points"].dtype not in (np.float32, np.float64):
        raise FormatError(f"{path}: points are {file['points'].dtype} of shape {shape}; it is damaged")
    times = _whole(path, file, "times")
    if len(times) != shape[0]:
        raise FormatError(f"{path}: {shape[0]} frames of points for {len(times)} times; it is damaged")
    return SequenceHeader(
        polygons=Polygons(_whole(path, file, "polygons/counts"), _whole(path, file, "polygons/indices")),
        vertex_count=shape[1],
        times=times,
        fps=float(file.attrs["fps"]),
        up_axis=str(file.attrs["up_axis"]),
        metres_per_unit=float(file.attrs["metres_per_unit"]),
        name=str(file.attrs["name"]),
    )


def _whole(path: Path, file: h5py.File, name: str) -> NDArray[Any]:
    try:
        array: NDArray[Any] = file[name][...]
    except OSError as error:
        raise FormatError(f"{path}: {name} is damaged ({brief(error)}); restore the file") from error
    return array


class _H5Reader(SequenceReader):
    def __init__(self, path: Path, header: SequenceHeader, file: h5py.File, resources: ExitStack) -> None:
        super().__init__(path, header, resources)
        self._file = file

    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        with _reading(self.path):
            points = self._file["points"]
        for start in range(0, len(points), size):
            stop = min(start + size, len(points))
            try:
                block: FloatArray = points[start:stop]
            except (OSError, RuntimeError, ValueError) as error:
                raise FormatError(
                    f"{self.path}: points of frames {start} to {stop - 1} are damaged ({brief(error)}); "
                    "restore the file"
                ) from error
            yield block.astype(block.dtype.newbyteorder("="), copy=False)


def write_h5(path: Path, header: SequenceHeader, blocks: Iterable[FloatArray]) -> None:
    """Write an HDF5 sequence, one block at a time; see `mixseq_io.write_blocks`."""
    with replacing(path) as temporary, temporary.open("w+b", buffering=0) as raw:
        store = _Store(raw)
        with h5py.File(store, "w", libver=("v110", "v110")) as file:
            _fill(file, header, blocks, store)
        store.check()


def _fill(file: h5py.File, header: SequenceHeader, blocks: Iterable[FloatArray], store: _Store) -> None:
    dtype, numbered = checked(header, blocks)
    file.attrs["format"] = FORMAT
    file.attrs["version"] = VERSION
    file.attrs["name"] = header.name
    file.attrs["fps"] = header.fps
    file.attrs["up_axis"] = header.up_axis
    file.attrs["metres_per_unit"] = header.metres_per_unit
    for name, array in (
        ("times", header.times),
        ("polygons/counts", header.polygons.counts),
        ("polygons/indices", header.polygons.indices),
    ):
        file.create_dataset(name, data=array, chunks=True, **_CHECKED)
    shape = (header.frame_count, header.vertex_count, 3)
    frame_bytes = header.vertex_count * 3 * dtype.itemsize
    frames = min(max(1, _CHUNK_BYTES // frame_bytes), header.frame_count)
    points = file.create_dataset("points", shape, dtype, chunks=(frames, *shape[1:]), **_CHECKED)
    for first, block in numbered:
        points[first : first + len(block)] = block
        store.check()


class _Store:
    """A file that takes what HDF5 gives it even if the disk does not, and tells afterwards.

    HDF5 cannot close a file that it cannot write: it keeps it half open, and the process dies of a
    segmentation fault later. So the first failure is kept for `check`, and nothing is written from there on.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._failure: OSError | None = None

    def check(self) -> None:
        """Raise the failure, if there was one."""
        if self._failure is not None:
            raise self._failure

    def write(self, data: memoryview) -> int:
        """Write all of the data."""
        rest = memoryview(data)
        while rest and self._failure is None:
            try:
                rest = rest[self._file.write(rest) :]
            except OSError as error:
                self._failure = error
        return len(data)

    def truncate(self, size: int) -> int:
        """Set the file's size."""
        if self._failure is None:
            try:
                return self._file.truncate(size)
            except OSError as error:
                self._failure = error
        return size

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a byte."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the current byte."""
        return self._file.tell()

    def read(self, size: int = -1) -> bytes:
        """Read bytes."""
        return self._file.read(size)

    def flush(self) -> None:
        """Do nothing: the file has no buffer, and is flushed to the disk before it gets its name."""
