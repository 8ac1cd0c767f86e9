"""Arrays and settings of a model in HDF5, with checksums; errors of kind, shape and range are `FormatError`."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.errors import FormatError
from mixseq.frame_store import LARGEST, SMALLEST
from mixseq.shells.fitting import ShellSettings
from mixseq_io.hdf5.contents import Contents
from mixseq_io.hdf5.h5_writing import put_array, put_text

_LARGEST = 1e20
"""Largest magnitude of valid numbers; products of several are still finite."""

_KINDS = {"integers": "iu", "floats": "f"}  # as NumPy names them


def put(file: h5py.File, name: str, array: NDArray[Any]) -> None:
    """Store an array, in single precision if that suffices."""
    if array.dtype == np.float64 and array.size:
        with np.errstate(over="ignore"):
            single = array.astype(np.float32)
        array = single if np.array_equal(single, array) else array
    put_array(file, name, array)


def put_lists(file: h5py.File, group: str, name: str, lists: Sequence[NDArray[Any]]) -> None:
    """Store lists of indices: their concatenation and their lengths."""
    sizes = np.array([len(items) for items in lists], dtype=np.int32)
    put_joined(file, group, name, sizes, np.concatenate([*lists, np.zeros(0, dtype=np.int32)]))


def put_joined(
    file: h5py.File, group: str, name: str, sizes: NDArray[np.integer], items: NDArray[np.integer]
) -> None:
    """Store lists as `put_lists`, given their lengths and their concatenation."""
    put(file, f"{group}/sizes", sizes.astype(np.int32))
    put(file, f"{group}/{name}", items.astype(np.int32))


def get_lists(path: Path, file: Contents, group: str, name: str, limit: int) -> list[Index]:
    """Read lists of indices below `limit` that `put_lists` stored."""
    sizes, items = get_joined(path, file, group, name, limit)
    return np.split(items, np.cumsum(sizes))[: len(sizes)]


def get_joined(path: Path, file: Contents, group: str, name: str, limit: int) -> tuple[Index, Index]:
    """Read the lengths of non-empty lists, and their concatenation."""
    sizes = integers(path, file, f"{group}/sizes", (None,), 1)
    return sizes, integers(path, file, f"{group}/{name}", (int(sizes.sum()),), 0, limit)


def integers(
    path: Path, file: Contents, name: str, shape: tuple[int | None, ...], low: int, limit: int | None = None
) -> Index:
    """Read integers from `low` to below `limit`; None in the shape allows any length."""
    array = _of_kind(path, file, name, shape, "integers")
    if array.size and (array.min() < low or (limit is not None and array.max() >= limit)):
        upper = "" if limit is None else f" to {limit - 1}"
        raise FormatError(f"{path}: {name} has values outside {low}{upper}; it is damaged")
    return array.astype(np.int64)


def floats(path: Path, file: Contents, name: str, shape: tuple[int | None, ...]) -> Float:
    """Read finite numbers of valid magnitude; None in the shape allows any length."""
    array = _finite(path, file, name, shape)
    if array.size and (large := np.abs(array)).max() > LARGEST:
        row = np.argwhere(large > LARGEST)[0, 0]
        raise FormatError(
            f"{path}: {name} has {large.max():g} in row {row}, beyond {LARGEST:g}; it is damaged"
        )
    return array


def _finite(path: Path, file: Contents, name: str, shape: tuple[int | None, ...]) -> Float:
    array = _of_kind(path, file, name, shape, "floats")
    if not np.isfinite(array).all():
        raise FormatError(f"{path}: {name} is not finite in row {np.argwhere(~np.isfinite(array))[0, 0]}")
    return array.astype(np.float64)


def diagonals(path: Path, file: Contents, name: str, shape: tuple[int | None, ...]) -> Float:
    """Read lengths or positions in diagonals: numbers as of `floats`, of plausible size."""
    array = _finite(path, file, name, shape)
    if array.size and np.abs(array).max() > _LARGEST:
        row = np.argwhere(np.abs(array) > _LARGEST)[0, 0]
        raise FormatError(f"{path}: {name} is above {_LARGEST:g} diagonals in row {row}; it is damaged")
    return array


def increasing(path: Path, file: Contents, name: str) -> Float:
    """Read at least one increasing time ``(n,)``."""
    times = floats(path, file, name, (None,))
    if not len(times):
        raise FormatError(f"{path}: {name} is empty; at least one time is needed")
    back = np.flatnonzero(np.diff(times) <= 0)
    if len(back):
        row = int(back[0]) + 1
        raise FormatError(
            f"{path}: {name} does not increase in row {row}: {times[row]:g} s after {times[row - 1]:g} s"
        )
    return times


def _of_kind(
    path: Path, file: Contents, name: str, shape: tuple[int | None, ...], kind: Literal["integers", "floats"]
) -> NDArray[Any]:
    if name not in file.arrays:
        raise FormatError(f"{path}: {name} is missing; it is damaged")
    array = file.arrays[name]
    fits = len(shape) == array.ndim and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype.kind not in _KINDS[kind]:
        lengths = ", ".join("any" if n is None else str(n) for n in shape)
        raise FormatError(
            f"{path}: {name} is {array.dtype} of shape {array.shape}; {kind} of shape ({lengths}) are expected"
        )
    return array


def read_scale(path: Path, file: Contents) -> float:
    """Read the length of the space's unit."""
    scale = float(file.attributes["space"]["scale"])
    if not SMALLEST <= scale <= LARGEST:
        raise FormatError(
            f"{path}: the scale of the space is {scale:g}; a number from {SMALLEST:g} to {LARGEST:g} is expected"
        )
    return scale


def write_settings(file: h5py.File, settings: Mapping[str, Mapping[str, Any]]) -> None:
    """Store settings by group."""
    put_text(file, "settings", json.dumps(settings, sort_keys=True))


def read_settings(path: Path, file: Contents, about: str, known: Collection[str]) -> dict[str, Any]:
    """Read all settings of a group."""
    found: dict[str, Any] = json.loads(file.text("settings"))[about]
    others = sorted(set(found) ^ set(known))
    if others:
        raise FormatError(f"{path}: the setting {others[0]!r} is missing or not known; it is damaged")
    return found


def read_shell(path: Path, file: Contents) -> ShellSettings:
    """Read the settings of fits to lengths and angles."""
    return ShellSettings(**read_settings(path, file, "shell", ShellSettings.__dataclass_fields__))
