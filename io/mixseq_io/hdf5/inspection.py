"""Worker's side of `mixseq_io.hdf5.contents`: reads HDF5 files after inspecting them; unusual contents are refused.

HDF5 files can refer to other files, link in circles, load code for unknown filters, and announce terabytes that were
never written. Names, types, shapes and storage, all under checksums of the 1.10 layout, are checked first. A dataset
may unpack to at most gzip's limit of 1032 bytes per stored byte; still sequences of mixseq reach 1023.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5t, h5z
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq_io.files import check_memory
from mixseq_io.hdf5.contents import Contents, translate_h5_errors
from mixseq_io.isolation import limit_time
from mixseq_io.reader import summarize_error

MAX_OBJECTS_PER_FILE = 1000
"""Largest number of groups and datasets of a file; mixseq's files have some 30."""

_DEEPEST = 8
_MOST_ATTRIBUTES = 100
_RANK = 4
_ATTRIBUTE_BYTES = 1 << 20
_UNPACKED = 1040
"""Largest number of bytes per stored byte: gzip's limit, and a little for rounding."""

_FILTERS = (h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32)
_NUMBERS = (h5t.INTEGER, h5t.FLOAT)
_LINKS = {h5l.TYPE_SOFT: "a soft link", h5l.TYPE_EXTERNAL: "a link to another file"}


class _Inspection:
    """Check of every object of a newly opened file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left = path.stat().st_size
        self._objects = 0

    def group(self, group: h5g.GroupID, name: str) -> None:
        """Check a group and its contents."""
        if name.count("/") > _DEEPEST:
            raise self._refusal(name, "is nested too deeply")
        self._attributes(group, name)
        if group.get_num_objs() > MAX_OBJECTS_PER_FILE:
            raise self._refusal(name, f"has more than {MAX_OBJECTS_PER_FILE} objects")
        for key in group:
            self._object(group, key, f"{name}/{key.decode('utf-8', 'replace')}")

    def _object(self, group: h5g.GroupID, key: bytes, name: str) -> None:
        self._objects += 1
        if self._objects > MAX_OBJECTS_PER_FILE:
            raise self._refusal(name, f"is one of more than {MAX_OBJECTS_PER_FILE} objects")
        kind = group.links.get_info(key).type
        if kind != h5l.TYPE_HARD:
            raise self._refusal(name, f"is {_LINKS.get(kind, 'a link of an unknown kind')}")
        found = h5o.open(group, key)
        if h5o.get_info(found).rc != 1:
            raise self._refusal(name, "has a second name")
        if isinstance(found, h5g.GroupID):
            self.group(found, name)
        elif isinstance(found, h5d.DatasetID):
            self._attributes(found, name)
            self._dataset(found, name)
        else:
            raise self._refusal(name, "is neither a group nor a dataset")

    def _attributes(self, found: h5g.GroupID | h5d.DatasetID, name: str) -> None:
        count = h5a.get_num_attrs(found)
        if count > _MOST_ATTRIBUTES:
            raise self._refusal(name, f"has {count} attributes")
        for number in range(count):
            attribute = h5a.open(found, index=number)
            what = f"{name or '/'}, attribute {attribute.name.decode('utf-8', 'replace')},"
            kind, space = attribute.get_type(), attribute.get_space()
            self._type(kind, what)
            if space.get_simple_extent_type() == h5py.h5s.NULL or space.get_simple_extent_ndims() > _RANK:
                raise self._refusal(what, "has no value, or too many axes")
            if space.get_simple_extent_npoints() * kind.get_size() > _ATTRIBUTE_BYTES:
                raise self._refusal(what, "is too large")

    def _dataset(self, found: h5d.DatasetID, name: str) -> None:
        storage = found.get_create_plist()
        layout = storage.get_layout()
        # First, since HDF5 opens external files when it is queried for the shape of their data.
        if layout not in (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED):
            raise self._refusal(name, "is a virtual dataset, of data elsewhere")
        if storage.get_external_count():
            raise self._refusal(name, "keeps its data in another file")
        for number in range(storage.get_nfilters()):
            code = storage.get_filter(number)[0]
            if code not in _FILTERS:
                raise self._refusal(name, f"is stored with the filter {code}")
        kind, space = found.get_type(), found.get_space()
        self._type(kind, name)
        if space.get_simple_extent_type() == h5py.h5s.NULL:
            raise self._refusal(name, "has no shape")
        shape = space.get_simple_extent_dims()
        if len(shape) > _RANK:
            raise self._refusal(name, f"has {len(shape)} axes")
        self._size(found, name, shape, storage.get_chunk() if layout == h5d.CHUNKED else ())

    def _type(self, kind: h5t.TypeID, name: str) -> None:
        if isinstance(kind, h5t.TypeStringID):
            if kind.is_variable_str():
                raise self._refusal(name, "has strings of any length")
        elif kind.get_class() not in _NUMBERS or kind.get_size() > np.dtype(np.float64).itemsize:
            raise self._refusal(name, f"has the type {_told(kind)}")

    def _size(self, found: h5d.DatasetID, name: str, shape: tuple[int, ...], chunk: tuple[int, ...]) -> None:
        stored: int = found.get_storage_size()
        elements, least = prod(shape), prod(chunk)  # a chunk is unpacked as a whole
        claimed = found.get_type().get_size() * (max(elements, least) if elements else 0)
        self._left -= stored
        if self._left < 0:
            raise self._refusal(name, "and what is before it claim more bytes than the file has")
        if claimed > _UNPACKED * stored:
            raise self._refusal(name, f"claims {claimed} bytes and has {stored} in the file")

    def _refusal(self, name: str, what: str) -> FormatError:
        return FormatError(
            f"{self._path}: {name or '/'} {what}, as nothing does in a file of mixseq's; it is damaged, or made by "
            "another program, and is not read"
        )


def _told(kind: h5t.TypeID) -> str:
    names = {h5t.REFERENCE: "reference", h5t.VLEN: "list of any length", h5t.COMPOUND: "compound"}
    return names.get(kind.get_class(), f"of class {kind.get_class()} and {kind.get_size()} bytes")


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
            raise FormatError(
                f"{path}: {name} is damaged ({summarize_error(error)}); restore the file"
            ) from error
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
    with translate_h5_errors(path), h5py.File(path, "r") as file:
        _Inspection(path).group(file.id, "")
        yield file
