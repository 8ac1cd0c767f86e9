r"""What packed vertices are before they are packed: numbers that have few bits where nobody sees more.

Octahedral
    Unit vectors, as the point of the octahedron :math:`|x| + |y| + |z| = 1` in their direction, unfolded into a square:
    two numbers of some bits, and a third that tells what 1 is.
Quaternion
    The three smaller components; the largest follows from them.
Exponential
    Floats :math:`m 2^e` with 24 bits of `m` and 8 of `e`. With one `e` for all they are fixed-point numbers.
Colour
    Luma and chroma (YCoCg).

Specification: https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import FormatError, SettingsError

Rows = NDArray[np.uint8]

_LARGEST = 2**23 - 1
"""Of the numbers m."""


def unfiltered(rows: Rows, name: str) -> Rows:
    """Return what a filter was applied to, bytes ``(n, stride)`` as the rows.

    Raises
    ------
    FormatError
        If the filter is unknown, or never used for vertices of so many bytes.
    """
    if name == "NONE":
        return rows
    filters: dict[str, tuple[tuple[int, ...], Callable[[Rows], NDArray[np.generic]]]] = {
        "OCTAHEDRAL": ((4, 8), _unfolded),
        "QUATERNION": ((8,), _quaternions),
        "EXPONENTIAL": (tuple(range(4, 257, 4)), _floats),
        "COLOR": ((4, 8), _colours),
    }
    strides, unfilter = filters.get(name, ((), _floats))
    if rows.shape[1] not in strides:
        raise FormatError(f"the filter {name[:40]!r} of {rows.shape[1]} bytes per vertex is not known here")
    with np.errstate(all="ignore"):  # damaged vectors may have length 0; what is not finite is found later
        made = np.ascontiguousarray(unfilter(rows))
    return made.view(np.uint8).reshape(rows.shape)


def _unfolded(rows: Rows) -> NDArray[np.signedinteger]:
    kind = np.int8 if rows.shape[1] == 4 else np.dtype("<i2")
    stored = np.ascontiguousarray(rows).view(kind)
    x, y = (stored[:, :2] / stored[:, 2:3].astype(np.float64)).T
    z = 1 - np.abs(x) - np.abs(y)
    under = np.maximum(-z, 0)
    x, y = x - np.where(x >= 0, under, -under), y - np.where(y >= 0, under, -under)
    vectors = np.stack([x, y, z], axis=1)
    vectors *= (127 if rows.shape[1] == 4 else 32767) / np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.column_stack([_whole(vectors), stored[:, 3]]).astype(stored.dtype)


def _quaternions(rows: Rows) -> NDArray[np.int16]:
    stored = np.ascontiguousarray(rows).view("<i2")
    one, largest = stored[:, 3:] | 3, (stored[:, 3] & 3).astype(np.int64)
    small = stored[:, :3] * (np.sqrt(0.5) / one)
    rest = np.sqrt(np.maximum(1 - np.square(small).sum(axis=1, keepdims=True), 0))
    values = _whole(np.concatenate([rest, small], axis=1) * 32767)
    turned = (np.arange(4) - largest[:, None]) % 4
    return np.take_along_axis(values, turned, axis=1).astype("<i2")


def _floats(rows: Rows) -> NDArray[np.float32]:
    stored = np.ascontiguousarray(rows).view("<i4")
    floats: NDArray[np.float32] = np.ldexp((stored << 8 >> 8).astype(np.float64), stored >> 24).astype("<f4")
    return floats


def _colours(rows: Rows) -> NDArray[np.unsignedinteger]:
    kind = np.dtype(np.uint8) if rows.shape[1] == 4 else np.dtype("<u2")
    stored = np.ascontiguousarray(rows).view(kind).astype(np.int64)
    signed = np.ascontiguousarray(rows).view(kind.str.replace("u", "i")).astype(np.int64)
    luma, alpha = stored[:, 0], stored[:, 3]
    orange, green = signed[:, 1], signed[:, 2]
    one = 2 ** (np.frexp(alpha)[1]) - 1  # all bits up to the highest of alpha
    opacity = alpha & (one >> 1)
    opacity = opacity << 1 | opacity & 1
    values = np.stack([luma + orange - green, luma + green, luma - orange - green, opacity], axis=1)
    return np.clip(_whole(values * (np.iinfo(kind).max / one[:, None])), 0, np.iinfo(kind).max).astype(kind)


def _whole(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round away from zero where there are two nearest."""
    return np.nan_to_num(np.trunc(values + np.copysign(0.5, values)))


def folded(vectors: ArrayLike, bits: int) -> Rows:
    """Return unit vectors ``(n, 3)`` for the filter OCTAHEDRAL: ``(n, 4)`` bytes up to 8 bits, ``(n, 8)`` up to 16."""
    v = np.asarray(vectors, dtype=np.float64)
    length = np.abs(v).sum(axis=1, keepdims=True)
    x, y, z = (v / np.where(length > 0, length, 1)).T
    u = np.where(z >= 0, x, (1 - np.abs(y)) * np.where(x >= 0, 1, -1))
    w = np.where(z >= 0, y, (1 - np.abs(x)) * np.where(y >= 0, 1, -1))
    one = 2 ** (bits - 1) - 1
    kind = np.dtype(np.int8) if bits <= 8 else np.dtype("<i2")
    stored = np.stack([_whole(u * one), _whole(w * one), np.full(len(v), one), np.zeros(len(v))], axis=1)
    return stored.astype(kind).view(np.uint8).reshape(len(v), -1)


def fixed_point(values: ArrayLike, exponent: int) -> Rows:
    """Return numbers ``(n, k)`` for the filter EXPONENTIAL, ``(n, 4 k)`` bytes, in steps of ``2**exponent``.

    Raises
    ------
    SettingsError
        If a number is more than 2**23 such steps.
    """
    steps = np.rint(np.ldexp(np.asarray(values, dtype=np.float64), -exponent))
    if not np.abs(steps).max(initial=0) <= _LARGEST:
        raise SettingsError(
            f"numbers up to {np.abs(values).max():g} are too large for steps of {2.0**exponent:g}: only "
            f"{_LARGEST} steps can be told apart; let coordinates begin near 0, or write without compression"
        )
    stored = steps.astype(np.int64) & 0xFFFFFF | (exponent & 0xFF) << 24
    return np.ascontiguousarray(stored.astype("<u4")).view(np.uint8).reshape(len(steps), -1)
