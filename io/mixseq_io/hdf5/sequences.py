"""Read and write HDF5 sequences: complete mesh sequences, deflated, with checksums.

``docs/file-format.md`` describes datasets and attributes. Points and velocities are stored in chunks of whole frames.
A file whose `format` is "mixseq-model" holds a model instead; see `mixseq_io.model_files`.
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
from mixseq_io.hdf5.contents import Contents, check_version, read_header, translate_h5_errors
from mixseq_io.hdf5.datasets import STORAGE_OPTIONS, create_h5, write_array, write_header, write_text
from mixseq_io.hdf5.inspection import load_datasets, open_inspected
from mixseq_io.isolation import open_isolated
from mixseq_io.reader import SequenceReader, prefix_errors, validate_blocks

SEQUENCE_FORMAT = "mixseq-sequence"
SEQUENCE_VERSION = 1

_FRAME_DATASETS = ("points", "velocities")
"""Names of the datasets that are read block by block."""

_MAX_CHUNK_BYTES = 1 << 20
"""Largest size of a chunk in bytes; chunks are read completely, and HDF5 caches 1 MiB of chunks by default."""


def open_h5_sequence(contents: Contents) -> SequenceReader:
    """Open an HDF5 sequence of mixseq, given the attributes of the file."""
    path = contents.path
    if contents.kind != SEQUENCE_FORMAT:
        raise FormatError(f"{path} is an HDF5 file, but not one of mixseq's (format = {contents.kind!r})")
    with translate_h5_errors(path):
        check_version(contents, SEQUENCE_VERSION)
    return open_isolated(f"{__name__}:_open", path, {})


def _open(path: Path) -> SequenceReader:
    with ExitStack() as resources:
        file = resources.enter_context(open_inspected(path))
        with prefix_errors(path):
            header = _header(path, file)
        return _H5Reader(path, header, file, resources.pop_all())


def _header(path: Path, file: h5py.File) -> SequenceHeader:
    names = _FRAME_DATASETS if "velocities" in file else _FRAME_DATASETS[:1]
    for name in names:
        if not isinstance(file[name], h5py.Dataset):
            raise FormatError(f"{path}: {name} is not a dataset; it is damaged")
    shape = file["points"].shape
    for name in names:
        dataset, dtype = file[name], file[name].dtype
        fits = dataset.shape == shape and len(shape) == 3 and shape[2] == 3
        if not fits or dtype not in (np.float32, np.float64):
            raise FormatError(f"{path}: {name} are {dtype} of shape {dataset.shape}; it is damaged")
    contents = load_datasets(path, file, _FRAME_DATASETS)
    times = contents.arrays["times"]
    if len(times) != shape[0]:
        raise FormatError(f"{path}: {shape[0]} frames of points for {len(times)} times; it is damaged")
    return read_header(contents, vertex_count=shape[1], times=times)


class _H5Reader(SequenceReader):
    def __init__(self, path: Path, header: SequenceHeader, file: h5py.File, resources: ExitStack) -> None:
        super().__init__(path, header, resources, has_velocities="velocities" in file)
        self._file = file

    def _read(self, quantity: str, size: int) -> Iterator[FloatArray]:
        with translate_h5_errors(self.path):
            dataset = self._file[quantity]
        for start in range(0, len(dataset), size):
            stop = min(start + size, len(dataset))
            try:
                block: FloatArray = dataset[start:stop]
            except (OSError, RuntimeError, ValueError) as error:
                first, last = (self.header.frame_number(index) for index in (start, stop - 1))
                raise FormatError(
                    f"{self.path}: {quantity} of frames {first} to {last} are damaged; restore the file"
                ) from error
            yield block.astype(block.dtype.newbyteorder("="), copy=False)


def write_h5(
    path: Path, header: SequenceHeader, blocks: Iterable[FloatArray], velocities: Iterable[FloatArray] | None = None
) -> None:
    """Write an HDF5 sequence block by block; see `mixseq_io.write_blocks`."""
    with create_h5(path) as (file, buffer):
        dtype, frame_blocks = validate_blocks(header, blocks, velocities)
        write_text(file, "format", SEQUENCE_FORMAT)
        file.attrs["version"] = SEQUENCE_VERSION
        write_header(file, header)
        write_array(file, "times", header.times)
        shape = (header.frame_count, header.vertex_count, 3)
        bytes_per_frame = header.vertex_count * 3 * dtype.itemsize
        chunk_frames = min(max(1, _MAX_CHUNK_BYTES // bytes_per_frame), header.frame_count)
        names = _FRAME_DATASETS[:1] if velocities is None else _FRAME_DATASETS
        chunks = (chunk_frames, *shape[1:])
        datasets = [file.create_dataset(name, shape, dtype, chunks=chunks, **STORAGE_OPTIONS) for name in names]
        for first_frame, points, velocity_block in frame_blocks:
            for dataset, block in zip(datasets, (points, velocity_block), strict=False):
                dataset[first_frame : first_frame + len(points)] = block
            buffer.check()
        for dataset in datasets:  # a fixed order makes files reproducible, see `write_array`
            dataset.flush()
