"""Colours as files have them: with or without alpha, as bytes or as floats; here they are red, green, blue, alpha.

No number is turned from one curve of brightness into another: what is linear stays so, and what is sRGB, too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray
from mixseq.sequence import SequenceHeader
from mixseq.surface import WHITE

LARGEST_BYTE = 255
"""The byte that stands for 1."""

# Ours. Of numbers from 0 to 255 only a nearly black mesh has none above it, and lit colours, of which 1 is white, are
# rarely so bright.
_BRIGHTEST = 16


def with_alpha(colours: FloatArray) -> FloatArray:
    """Return colours ``(n, 3)`` as ``(n, 4)``, opaque, or such ``(n, 4)`` as they are."""
    return np.hstack(
        [colours[:, :3], np.ones_like(colours[:, :1]) if colours.shape[1] == 3 else colours[:, 3:]]
    )


def from_text(numbers: FloatArray) -> FloatArray:
    """Return the colours that texts tell: numbers from 0 to 255 if the largest is above 16, else as they are.

    Examples
    --------
    >>> from_text(np.array([[0.0, 51.0, 255.0]])).tolist(), from_text(np.array([[0.0, 0.2, 1.5]])).tolist()
    ([[0.0, 0.2, 1.0]], [[0.0, 0.2, 1.5]])
    """
    return numbers / (LARGEST_BYTE if numbers[np.isfinite(numbers)].max(initial=0) > _BRIGHTEST else 1)


def of_bytes(values: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return bytes as numbers from 0 to 1."""
    return (values / np.float32(LARGEST_BYTE)).astype(np.float32)


def nearest_bytes(values: FloatArray) -> NDArray[np.uint8]:
    """Return the bytes that `of_bytes` makes the nearest numbers of."""
    return np.rint(LARGEST_BYTE * within_one(values)).astype(np.uint8)


def as_bytes(values: FloatArray) -> NDArray[np.uint8] | None:
    """Return numbers as the bytes that `of_bytes` makes them of, None if there are none.

    Examples
    --------
    >>> as_bytes(np.array([0.2, 1.0], dtype=np.float32)).tolist(), as_bytes(np.array([0.3001]))
    ([51, 255], None)
    """
    rounded = nearest_bytes(values)
    return rounded if np.array_equal(of_bytes(rounded), values) else None


def within_one(values: FloatArray) -> FloatArray:
    """Return numbers from 0 to 1, as near as there are some."""
    return np.clip(np.nan_to_num(values), 0, 1)


def colours_of_vertices(header: SequenceHeader, channels: int) -> list[str]:
    """Return the colours of vertices as texts write them behind coordinates: " 0.2 0 1"; empty if there are none."""
    colours, vertices = header.surface.colours, header.polygons.indices
    if colours is None:
        return []
    values = within_one(colours.at_vertices(vertices, header.vertex_count, WHITE)[:, :channels])
    return ["".join(f" {number!s}".removesuffix(".0") for number in row) for row in values]
