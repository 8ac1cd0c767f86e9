"""Access to alembic3d, a package of Alembic's official Python binding: archives, errors, and `imath` arrays.

Specification: https://docs.alembic.io/python/alembic.html, https://docs.alembic.io/reference/index.html
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import FormatError, MissingExtraError

try:
    import imath as imath
    from alembic3d import Abc as Abc
    from alembic3d import AbcCoreAbstract as AbcCoreAbstract
    from alembic3d import AbcGeom as AbcGeom
    from alembic3d import AbcMaterial as AbcMaterial
except ImportError as error:
    raise MissingExtraError("Alembic files need the package alembic3d: pip install 'mixseq[alembic]'") from error

LIBRARY_ERRORS: tuple[type[Exception], ...] = (
    RuntimeError,
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
)
"""Exceptions that the library or value conversions raise for damaged files."""

_COLOUR_CHANNELS = {imath.C3fArray: "rgb", imath.C4fArray: "rgba"}
"""Types of colour arrays; NumPy can access these arrays only by channel."""

_HEADER_BYTES = 16
"""Size of an Ogawa header: "Ogawa", 255 if the file is complete, version (2 bytes), offset of the root group (8)."""


def open_archive(path: Path) -> Any:
    """Open a file as an ``IArchive``."""
    with path.open("rb") as file:
        start = file.read(_HEADER_BYTES)
    if start.startswith(b"\x89HDF"):
        raise FormatError(
            f"{path} is old Alembic based on HDF5; convert it with abcconvert -toOgawa, or export it again"
        )
    if not start.startswith(b"Ogawa"):
        raise FormatError(f"{path} cannot be read as Alembic; it is damaged or of another type")
    if len(start) < _HEADER_BYTES or start[5] != 0xFF or int.from_bytes(start[8:], "little") >= path.stat().st_size:
        raise FormatError(f"{path} is not complete; it is truncated, or was not written to its end")
    return Abc.IArchive(str(path))


def sample_selector(sampled: Any, sample: int) -> Any:
    """Return the selector of a sample by its time, since Python's constructor interprets an index as a time."""
    time = sampled.getTimeSampling().getSampleTime(sample)
    return Abc.ISampleSelector(time, Abc.ISampleSelector.TimeIndexType.kNearIndex)


def sample_length(array: Any, sample: int) -> int:
    """Return the length of an array sample without reading it."""
    return int(array.getDimension(sample_selector(array, sample)).numPoints())


def read_sample(array: Any, sample: int, file_size: int) -> NDArray[Any]:
    """Return an array sample ``(n,)`` or ``(n, k)``; check its size against the file size in bytes."""
    stored = read_imath_sample(array, sample, file_size)
    channels = _COLOUR_CHANNELS.get(type(stored))
    if channels:
        return np.stack([np.asarray(getattr(stored, channel)) for channel in channels], axis=1)
    return np.array(stored)


def read_imath_sample(array: Any, sample: int, file_size: int) -> Any:
    """Return an array sample as an imath array; see `read_sample`."""
    count = sample_length(array, sample)
    if count * array.getDataType().getNumBytes() > file_size:
        raise FormatError(f"an array claims {count} values, more than the file can hold; it is damaged")
    return array.getValue(sample_selector(array, sample))


def create_array(kind: Any, rows: ArrayLike) -> Any:
    """Create an imath array of a type such as ``V3fArray`` from rows ``(n, k)``."""
    values = np.asarray(rows)
    array = kind(len(values))
    if kind in _COLOUR_CHANNELS:
        for channel, column in zip(_COLOUR_CHANNELS[kind], values.T, strict=False):
            np.asarray(getattr(array, channel))[...] = column
    elif kind is imath.UnsignedIntArray:  # NumPy cannot access this type
        for index, value in enumerate(values.tolist()):
            array[index] = value
    elif len(values):
        np.asarray(array)[...] = values
    return array
