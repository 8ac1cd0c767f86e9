"""Inspect and read HDF5 files in the worker of `mixseq_io.hdf5.contents`; files with unusual contents are rejected.

HDF5 files can refer to other files, contain cycles of links, load code for unknown filters, and declare terabytes of
unwritten data. Therefore names, types, shapes and storage are inspected before data is read; the 1.10 layout protects
them by checksums. A dataset may unpack to gzip's limit of 1032 bytes per stored byte; still sequences reach 1023.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
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

MAX_OBJECTS_PER_FILE = 6000
"""Largest number of groups and datasets; mixseq's files have about 50 for each body, of which there are up to 101."""

_MAX_GROUP_DEPTH = 8
_MAX_ATTRIBUTES_PER_OBJECT = 100
_MAX_RANK = 4
_MAX_ATTRIBUTE_BYTES = 1 << 20
_MAX_COMPRESSION_RATIO = 1040
"""Largest number of unpacked bytes per stored byte: the limit of gzip with a margin for rounding."""

_ATTRIBUTE_TIME_FRACTION = 1 / 60
"""Fraction of the time limit for reading attributes, which are small; damaged attributes may loop forever."""

_ALLOWED_FILTERS = (h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32)
_NUMBER_CLASSES = (h5t.INTEGER, h5t.FLOAT)
_LINK_NAMES = {h5l.TYPE_SOFT: "a soft link", h5l.TYPE_EXTERNAL: "a link to another file"}
_TYPE_NAMES = {h5t.REFERENCE: "reference", h5t.VLEN: "list of any length", h5t.COMPOUND: "compound"}


class _FileInspector:
    """Inspector of all objects of an open file, which counts objects and stored bytes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._remaining_bytes = path.stat().st_size
        self._object_count = 0

    def check_group(self, group: h5g.GroupID, name: str) -> None:
        """Check a group and all objects in the group."""
        if name.count("/") > _MAX_GROUP_DEPTH:
            raise self._rejection(name, "is nested too deeply")
        self._check_attributes(group, name)
        if group.get_num_objs() > MAX_OBJECTS_PER_FILE:
            raise self._rejection(name, f"has more than {MAX_OBJECTS_PER_FILE} objects")
        for key in group:
            self._check_object(group, key, f"{name}/{key.decode('utf-8', 'replace')}")

    def _check_object(self, group: h5g.GroupID, key: bytes, name: str) -> None:
        self._object_count += 1
        if self._object_count > MAX_OBJECTS_PER_FILE:
            raise self._rejection(name, f"is one of more than {MAX_OBJECTS_PER_FILE} objects")
        link = group.links.get_info(key).type
        if link != h5l.TYPE_HARD:
            raise self._rejection(name, f"is {_LINK_NAMES.get(link, 'a link of an unknown kind')}")
        item = h5o.open(group, key)
        if h5o.get_info(item).rc != 1:
            raise self._rejection(name, "has a second name")
        if isinstance(item, h5g.GroupID):
            self.check_group(item, name)
        elif isinstance(item, h5d.DatasetID):
            self._check_attributes(item, name)
            self._check_dataset(item, name)
        else:
            raise self._rejection(name, "is neither a group nor a dataset")

    def _check_attributes(self, item: h5g.GroupID | h5d.DatasetID, name: str) -> None:
        count = h5a.get_num_attrs(item)
        if count > _MAX_ATTRIBUTES_PER_OBJECT:
            raise self._rejection(name, f"has {count} attributes")
        for index in range(count):
            attribute = h5a.open(item, index=index)
            label = f"{name or '/'}, attribute {attribute.name.decode('utf-8', 'replace')},"
            dtype, space = attribute.get_type(), attribute.get_space()
            self._check_type(dtype, label)
            if space.get_simple_extent_type() == h5py.h5s.NULL or space.get_simple_extent_ndims() > _MAX_RANK:
                raise self._rejection(label, "has no value, or too many axes")
            if space.get_simple_extent_npoints() * dtype.get_size() > _MAX_ATTRIBUTE_BYTES:
                raise self._rejection(label, "is too large")

    def _check_dataset(self, dataset: h5d.DatasetID, name: str) -> None:
        storage = dataset.get_create_plist()
        layout = storage.get_layout()
        # Layout and storage are checked first, because reading the shape makes HDF5 open external files.
        if layout not in (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED):
            raise self._rejection(name, "is a virtual dataset, of data elsewhere")
        if storage.get_external_count():
            raise self._rejection(name, "keeps its data in another file")
        for index in range(storage.get_nfilters()):
            code = storage.get_filter(index)[0]
            if code not in _ALLOWED_FILTERS:
                raise self._rejection(name, f"is stored with the filter {code}")
        self._check_type(dataset.get_type(), name)
        space = dataset.get_space()
        if space.get_simple_extent_type() == h5py.h5s.NULL:
            raise self._rejection(name, "has no shape")
        shape = space.get_simple_extent_dims()
        if len(shape) > _MAX_RANK:
            raise self._rejection(name, f"has {len(shape)} axes")
        self._check_size(dataset, name, shape, storage.get_chunk() if layout == h5d.CHUNKED else ())

    def _check_type(self, dtype: h5t.TypeID, name: str) -> None:
        kind, size = dtype.get_class(), dtype.get_size()
        if isinstance(dtype, h5t.TypeStringID):
            if dtype.is_variable_str():
                raise self._rejection(name, "has strings of any length")
        elif kind not in _NUMBER_CLASSES or size > np.dtype(np.float64).itemsize:
            type_name = _TYPE_NAMES.get(kind, f"of class {kind} and {size} bytes")
            raise self._rejection(name, f"has the type {type_name}")

    def _check_size(self, dataset: h5d.DatasetID, name: str, shape: tuple[int, ...], chunk: tuple[int, ...]) -> None:
        stored_bytes: int = dataset.get_storage_size()
        count = prod(shape) and max(prod(shape), prod(chunk))  # chunks are unpacked completely
        declared_bytes = dataset.get_type().get_size() * count
        self._remaining_bytes -= stored_bytes
        if self._remaining_bytes < 0:
            raise self._rejection(name, "and what is before it claim more bytes than the file has")
        if declared_bytes > _MAX_COMPRESSION_RATIO * stored_bytes:
            raise self._rejection(name, f"claims {declared_bytes} bytes and has {stored_bytes} in the file")

    def _rejection(self, name: str, problem: str) -> FormatError:
        return FormatError(
            f"{self._path}: {name or '/'} {problem}, which is never the case in files of mixseq; the file is damaged, "
            "or made by another program, and is not read"
        )


def load_contents(path: Path, kind: str) -> Contents:
    """Read a file for `mixseq_io.hdf5.contents.read_contents`."""
    limit_time(_ATTRIBUTE_TIME_FRACTION)
    with open_inspected(path) as file:
        groups, datasets = _list_objects(file)
        contents = Contents(path, _read_attributes(groups), {})
        if contents.kind != kind:
            return contents
        limit_time(1)
        return Contents(path, contents.attributes, _read_arrays(path, datasets, ()))


def load_datasets(path: Path, file: h5py.File, excluded: Collection[str]) -> Contents:
    """Read the attributes and datasets of an open file, except for the datasets `excluded`."""
    groups, datasets = _list_objects(file)
    return Contents(path, _read_attributes(groups), _read_arrays(path, datasets, excluded))


def _read_attributes(groups: Mapping[str, h5py.Group]) -> dict[str, dict[str, Any]]:
    return {name: dict(group.attrs) for name, group in groups.items()}


def _read_arrays(
    path: Path, datasets: Mapping[str, h5py.Dataset], excluded: Collection[str]
) -> dict[str, NDArray[Any]]:
    needed = sum(_memory_bytes(dataset, name in excluded) for name, dataset in datasets.items())
    check_memory(path, needed, "its datasets")
    arrays: dict[str, NDArray[Any]] = {}
    for name, dataset in datasets.items():
        if name not in excluded:
            try:
                arrays[name] = dataset[...]
            except OSError as error:
                raise FormatError(f"{path}: {name} is damaged; restore the file") from error
    return arrays


def _memory_bytes(dataset: h5py.Dataset, by_chunk: bool) -> int:
    """Return the memory in bytes of a dataset or, if `by_chunk`, of one chunk, since chunks are unpacked completely."""
    chunk = prod(dataset.chunks or (1,))
    return int(dataset.dtype.itemsize * (chunk if by_chunk else max(dataset.size, chunk)))


def _list_objects(file: h5py.File) -> tuple[dict[str, h5py.Group], dict[str, h5py.Dataset]]:
    """Return all groups by name, with "" for the root, and all datasets by name."""
    names: list[str] = []
    file.visit(names.append)
    objects = {"": file} | {name: file[name] for name in names}
    datasets = {name: item for name, item in objects.items() if isinstance(item, h5py.Dataset)}
    return {name: item for name, item in objects.items() if name not in datasets}, datasets


@contextmanager
def open_inspected(path: Path) -> Iterator[h5py.File]:
    """Open a file in this process, and raise an error unless all its contents are permitted."""
    with translate_h5_errors(path), h5py.File(path, "r") as file:
        _FileInspector(path).check_group(file.id, "")
        yield file
