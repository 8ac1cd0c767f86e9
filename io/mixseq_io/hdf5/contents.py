"""Read HDF5 files in a process of their own: attributes and arrays come from there as plain values.

One flipped bit in a string of any length lets HDF5 search for ever, deaf to Ctrl-C, and a crafted file can crash it.
So HDF5 reads no file in the user's process, see `mixseq_io.isolation`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq_io.hdf5.permitted import check_permitted
from mixseq_io.isolation import call_isolated, limit_time
from mixseq_io.memory import check_memory
from mixseq_io.reader import brief, check_regular, reading

_SHARE = 1 / 60
"""Part of the time limit that is enough for attributes: there is little to read, and damage in them has no end."""


@dataclass(frozen=True)
class Contents:
    """What is in an HDF5 file.

    Parameters
    ----------
    attributes : mapping of str to mapping
        Attributes by the name of their group; that of the root is empty.
    arrays : mapping of str to array
        Datasets by their names.
    """

    attributes: Mapping[str, Mapping[str, Any]]
    arrays: Mapping[str, NDArray[Any]]

    @property
    def attrs(self) -> Mapping[str, Any]:
        """Attributes of the root."""
        return self.attributes[""]

    @property
    def kind(self) -> str | None:
        """The root attribute `format`."""
        return self.text("format") if isinstance(self.attrs.get("format"), bytes | str) else None

    def text(self, name: str, group: str = "") -> str:
        """Return an attribute as text, whether it was stored with a fixed length or, as formerly, with any."""
        value = self.attributes[group][name]
        return value.decode("utf-8", "surrogateescape") if isinstance(value, bytes) else str(value)


def read_attributes(path: Path) -> Contents:
    """Read a file's attributes, and no arrays.

    Raises
    ------
    FormatError
        If the file is missing or damaged, or has what ours do not have, see `mixseq_io.hdf5.permitted`.
    """
    check_regular(path, "HDF5")
    found: Contents = call_isolated(f"{__name__}:_attributes", path)
    return found


def read_contents(path: Path, kind: str | None = None) -> Contents:
    """Read a whole file; if its `format` is another than `kind`, where one is given, its attributes only.

    Raises
    ------
    FormatError
        As `read_attributes`; also if a dataset is damaged, or all together take more than `mixseq_io.memory` allows.
    """
    check_regular(path, "HDF5")
    found: Contents = call_isolated(f"{__name__}:_contents", path, kind)
    return found


def _attributes(path: Path) -> Contents:
    limit_time(_SHARE)
    with opened_h5(path) as file:
        return Contents(_attributes_of(file), {})


def _contents(path: Path, kind: str | None) -> Contents:
    limit_time(_SHARE)
    with opened_h5(path) as file:
        found = Contents(_attributes_of(file), {})
        if kind not in (None, found.kind):
            return found
        limit_time(1)
        return contents_of(path, file)


def contents_of(path: Path, file: h5py.File, but: Collection[str] = ()) -> Contents:
    """Read all of an open file, `but` some datasets.

    Raises
    ------
    FormatError
        If a dataset is damaged, or they take more memory than is allowed.
    """
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
    """Return the bytes that a dataset takes in memory, or those of a chunk, which is unpacked as a whole."""
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
    """Open a file in this process, if there is nothing in it that our files do not have.

    Raises
    ------
    FormatError
        If it is missing, damaged, or refused by `check_permitted`; also for what h5py raises while it is open.
    """
    with reading_h5(path), h5py.File(path, "r") as file:
        check_permitted(path, file)
        yield file


def reading_h5(path: Path) -> AbstractContextManager[None]:
    """Turn what h5py raises on damaged files, and what is missing, into `FormatError`."""
    return reading(path, "HDF5", KeyError, RuntimeError, ValueError, TypeError, AttributeError, OverflowError)
