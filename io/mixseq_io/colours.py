"""Colours of files, with or without alpha, as bytes or floats, converted to RGBA; linear and sRGB values stay so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray
from mixseq.sequence import SequenceHeader
from mixseq.surface import WHITE

LARGEST_BYTE = 255
"""Byte value of 1.0."""

# Colours from 0 to 255 have larger numbers unless the mesh is nearly black; lit colours, with 1 as white, rarely do.
_BRIGHTEST = 16


def with_alpha(colours: FloatArray) -> FloatArray:
    """Return colours ``(n, 3)`` as opaque ``(n, 4)``; colours ``(n, 4)`` as they are."""
    return np.hstack(
        [colours[:, :3], np.ones_like(colours[:, :1]) if colours.shape[1] == 3 else colours[:, 3:]]
    )


def from_text(numbers: FloatArray) -> FloatArray:
    """Return colours of text files: divided by 255 if the largest number is above 16, else as they are."""
    return numbers / (LARGEST_BYTE if numbers[np.isfinite(numbers)].max(initial=0) > _BRIGHTEST else 1)


def of_bytes(values: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return bytes as floats from 0 to 1."""
    return (values / np.float32(LARGEST_BYTE)).astype(np.float32)


def nearest_bytes(values: FloatArray) -> NDArray[np.uint8]:
    """Return the bytes whose floats (`of_bytes`) are nearest."""
    return np.rint(LARGEST_BYTE * within_one(values)).astype(np.uint8)


def as_bytes(values: FloatArray) -> NDArray[np.uint8] | None:
    """Return the bytes whose floats (`of_bytes`) are exactly the given ones, None if there are none."""
    rounded = nearest_bytes(values)
    return rounded if np.array_equal(of_bytes(rounded), values) else None


def within_one(values: FloatArray) -> FloatArray:
    """Clip numbers to 0 to 1."""
    return np.clip(np.nan_to_num(values), 0, 1)


def colours_of_vertices(header: SequenceHeader, channels: int) -> list[str]:
    """Return the colours of vertices as text behind coordinates, such as " 0.2 0 1"; empty if there are none."""
    colours, vertices = header.surface.colours, header.polygons.indices
    if colours is None:
        return []
    values = within_one(colours.at_vertices(vertices, header.vertex_count, WHITE)[:, :channels])
    return ["".join(f" {number!s}".removesuffix(".0") for number in row) for row in values]
