"""Access to alembic3d, the packaged official binding of Alembic: archives, errors, and arrays of its `imath`.

Specification: https://docs.alembic.io/python/alembic.html, https://docs.alembic.io/reference/index.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import FormatError, MissingExtraError

try:
    import imath
    from alembic3d import Abc, AbcCoreAbstract, AbcGeom, AbcMaterial
except ImportError as error:
    raise MissingExtraError(
        "Alembic files need the package alembic3d: pip install 'mixseq[alembic]'"
    ) from error

__all__ = [
    "ERRORS",
    "Abc",
    "AbcCoreAbstract",
    "AbcGeom",
    "AbcMaterial",
    "array_of",
    "imath",
    "length",
    "open_archive",
    "selector",
    "stored_array",
    "values",
]

ERRORS: tuple[type[Exception], ...] = (RuntimeError, ValueError, TypeError, LookupError, ArithmeticError)
"""Exceptions of the library for damaged files, and of converting their values."""

_CHANNELS = {imath.C3fArray: "rgb", imath.C4fArray: "rgba"}
"""Colour arrays, of which NumPy accesses single channels without copying number by number."""

_HEADER = 16
"""Bytes of an Ogawa header: "Ogawa", 255 once the file is complete, version (2), where the root group is (8)."""


def open_archive(path: Path) -> Any:
    """Open a file, an ``IArchive``."""
    with path.open("rb") as file:
        start = file.read(_HEADER)
    if start.startswith(b"\x89HDF"):
        raise FormatError(
            f"{path} is old Alembic of the HDF5 kind; convert it with abcconvert -toOgawa, or export it again"
        )
    if not start.startswith(b"Ogawa"):
        raise FormatError(f"{path} cannot be read as Alembic; it is damaged or of another type")
    if len(start) < _HEADER or start[5] != 0xFF or int.from_bytes(start[8:], "little") >= path.stat().st_size:
        raise FormatError(f"{path} is not complete; it is truncated, or was not written to its end")
    return Abc.IArchive(str(path))


def selector(sampled: Any, sample: int) -> Any:
    """Return the selector of a sample by its time, since the constructor takes numbers for times in Python."""
    time = sampled.getTimeSampling().getSampleTime(sample)
    return Abc.ISampleSelector(time, Abc.ISampleSelector.TimeIndexType.kNearIndex)


def length(array: Any, sample: int) -> int:
    """Return the length of an array sample without reading it."""
    return int(array.getDimension(selector(array, sample)).numPoints())


def values(array: Any, sample: int, room: int) -> NDArray[Any]:
    """Return an array sample; `room` is the file's size in bytes."""
    stored = stored_array(array, sample, room)
    channels = _CHANNELS.get(type(stored))
    if channels:
        return np.stack([np.asarray(getattr(stored, each)) for each in channels], axis=1)
    return np.array(stored)


def stored_array(array: Any, sample: int, room: int) -> Any:
    """Return an array sample as an array of imath; see `values`."""
    count = length(array, sample)
    if count * array.getDataType().getNumBytes() > room:
        raise FormatError(f"an array claims {count} values, more than the file can hold; it is damaged")
    return array.getValue(selector(array, sample))


def array_of(kind: Any, rows: ArrayLike) -> Any:
    """Return an array of imath, such as ``V3fArray``, with given rows ``(n, k)``."""
    content = np.asarray(rows)
    filled = kind(len(content))
    if kind in _CHANNELS:
        for channel, column in zip(_CHANNELS[kind], content.T, strict=False):
            np.asarray(getattr(filled, channel))[...] = column
    elif kind is imath.UnsignedIntArray:  # the one that NumPy cannot see into
        for place, value in enumerate(content.tolist()):
            filled[place] = value
    elif len(content):
        np.asarray(filled)[...] = content
    return filled
