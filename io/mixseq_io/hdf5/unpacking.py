"""Worker's side of `mixseq_io.hdf5.contents`: reads HDF5 files."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq_io.hdf5.contents import Contents, reading_h5
from mixseq_io.hdf5.permitted import check_permitted
from mixseq_io.isolation import limit_time
from mixseq_io.memory import check_memory
from mixseq_io.reader import brief

_SHARE = 1 / 60
"""Share of the time limit for attributes, which are small; damaged ones may loop forever."""


def attributes(path: Path) -> Contents:
    """Read a file's attributes, as `mixseq_io.hdf5.contents.read_attributes`."""
    limit_time(_SHARE)
    with opened_h5(path) as file:
        return Contents(_attributes_of(file), {})


def contents(path: Path, kind: str | None) -> Contents:
    """Read a file, as `mixseq_io.hdf5.contents.read_contents`."""
    limit_time(_SHARE)
    with opened_h5(path) as file:
        found = Contents(_attributes_of(file), {})
        if kind not in (None, found.kind):
            return found
        limit_time(1)
        return contents_of(path, file)


def contents_of(path: Path, file: h5py.File, but: Collection[str] = ()) -> Contents:
    """Read an open file, except for the datasets `but`."""
    _, datasets = _objects(file)
    check_memory(path, sum(_unpacked(each, name in but) for name, each in datasets.items()), "its datasets")
    arrays: dict[str, NDArray[Any]] = {}
    for name in (name for name in datasets if name not in but):
        try:
            arrays[name] = datasets[name][...]
        except OSError as error:
            raise FormatError(f"{path}: {name} is damaged ({brief(error)}); restore the file") from error
    return Contents(_attributes_of(file), arrays)


def _attributes_of(file: h5py.File) -> dict[str, dict[str, Any]]:
    return {name: dict(each.attrs) for name, each in _objects(file)[0].items()}


def _unpacked(dataset: h5py.Dataset, in_part: bool) -> int:
    """Return the size of a dataset in memory in bytes, or of one chunk, which is unpacked as a whole."""
    chunk = prod(dataset.chunks or (1,))
    return int(dataset.dtype.itemsize * (chunk if in_part else max(dataset.size, chunk)))


def _objects(file: h5py.File) -> tuple[dict[str, h5py.Group], dict[str, h5py.Dataset]]:
    names: list[str] = []
    file.visit(names.append)
    every = {"": file} | {name: file[name] for name in names}
    datasets = {name: each for name, each in every.items() if isinstance(each, h5py.Dataset)}
    return {name: each for name, each in every.items() if name not in datasets}, datasets


@contextmanager
def opened_h5(path: Path) -> Iterator[h5py.File]:
    """Open a file in this process after checking that it holds only permitted contents."""
    with reading_h5(path), h5py.File(path, "r") as file:
        check_permitted(path, file)
        yield file
