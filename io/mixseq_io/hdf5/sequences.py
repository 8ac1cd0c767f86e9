"""HDF5 sequences: complete mesh sequences, compressed, with checksums.

::

    /                    format = "mixseq-sequence", version = 1, name, fps,
                         up_axis, metres_per_unit
    /points              (T, V, 3) float32 or float64, in chunks of whole frames
    /velocities          as points, units per second; optional
    /times               (T,) float64, seconds
    /polygons/counts     (P,) int32
    /polygons/indices    (sum of counts,) int32
    /surface/...         texture coordinates and the like, see `mixseq_io.surfaces`; optional

A file of `format` "mixseq-model" holds a model instead, see `mixseq_io.loading`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path

import h5py
import numpy as np

from mixseq.errors import FormatError
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.hdf5.contents import check_version, read_attributes, read_header, translate_h5_errors
from mixseq_io.hdf5.datasets import CHECKED, creating_h5, put_array, put_text, write_header
from mixseq_io.hdf5.inspection import contents_of, opened_h5
from mixseq_io.isolation import open_isolated
from mixseq_io.reader import SequenceReader, prefix_errors, summarize_error, validate_blocks

FORMAT = "mixseq-sequence"
VERSION = 1

_BY_FRAME = ("points", "velocities")
"""Datasets read frame by frame on demand."""

# A chunk is compressed and read as a whole; HDF5 keeps 1 MiB of them by default.
_CHUNK_BYTES = 1 << 20


def open_h5(path: Path) -> SequenceReader:
    """Open an HDF5 sequence of mixseq."""
    found = read_attributes(path)
    if found.kind != FORMAT:
        raise FormatError(f"{path} is an HDF5 file, but not one of mixseq's (format = {found.kind!r})")
    with translate_h5_errors(path):
        check_version(path, found, VERSION)
    return open_isolated(f"{__name__}:_open", path, {})


def _open(path: Path) -> SequenceReader:
    with ExitStack() as resources:
        file = resources.enter_context(opened_h5(path))
        with prefix_errors(path):
            header = _header(path, file)
        return _H5Reader(path, header, file, resources.pop_all())


def _header(path: Path, file: h5py.File) -> SequenceHeader:
    names = _BY_FRAME if "velocities" in file else _BY_FRAME[:1]
    for name in names:
        if not isinstance(file[name], h5py.Dataset):
            raise FormatError(f"{path}: {name} is no dataset; it is damaged")
    shape = file["points"].shape
    for name in names:
        found, dtype = file[name].shape, file[name].dtype
        if len(found) != 3 or found[2] != 3 or found != shape or dtype not in (np.float32, np.float64):
            raise FormatError(f"{path}: {name} are {dtype} of shape {found}; it is damaged")
    contents = contents_of(path, file, _BY_FRAME)
    times = contents.arrays["times"]
    if len(times) != shape[0]:
        raise FormatError(f"{path}: {shape[0]} frames of points for {len(times)} times; it is damaged")
    return read_header(path, contents, vertex_count=shape[1], times=times)


class _H5Reader(SequenceReader):
    def __init__(self, path: Path, header: SequenceHeader, file: h5py.File, resources: ExitStack) -> None:
        super().__init__(path, header, resources, has_velocities="velocities" in file)
        self._file = file

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        with translate_h5_errors(self.path):
            dataset = self._file[what]
        for start in range(0, len(dataset), size):
            stop = min(start + size, len(dataset))
            try:
                block: FloatArray = dataset[start:stop]
            except (OSError, RuntimeError, ValueError) as error:
                first, last = (self.header.frame_number(index) for index in (start, stop - 1))
                raise FormatError(
                    f"{self.path}: {what} of frames {first} to {last} are damaged ({summarize_error(error)}); "
                    "restore the file"
                ) from error
            yield block.astype(block.dtype.newbyteorder("="), copy=False)


def write_h5(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
) -> None:
    """Write an HDF5 sequence, one block at a time; see `mixseq_io.write_blocks`."""
    with creating_h5(path) as (file, store):
        dtype, numbered = validate_blocks(header, blocks, velocities)
        put_text(file, "format", FORMAT)
        file.attrs["version"] = VERSION
        write_header(file, header)
        put_array(file, "times", header.times)
        shape = (header.frame_count, header.vertex_count, 3)
        frame_bytes = header.vertex_count * 3 * dtype.itemsize
        frames = min(max(1, _CHUNK_BYTES // frame_bytes), header.frame_count)
        names = _BY_FRAME[:1] if velocities is None else _BY_FRAME
        datasets = [
            file.create_dataset(name, shape, dtype, chunks=(frames, *shape[1:]), **CHECKED) for name in names
        ]
        for first, points, speeds in numbered:
            for dataset, block in zip(datasets, (points, speeds), strict=False):
                dataset[first : first + len(points)] = block
            store.check()
        for dataset in datasets:  # one after the other, not as they happen to be closed: see `put_array`
            dataset.flush()
