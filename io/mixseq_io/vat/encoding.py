r"""Numbers as pixels, decoded by shaders as :math:`o + s\,p` of a pixel :math:`p` between 0 and 1.

PNG holds `p` in 16 bits (8 for normals of single frames), EXR the numbers themselves, with o = 0 and s = 1. Decoded
numbers are returned with the pixels, for measuring errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]
Kind = type[np.uint8] | type[np.uint16] | type[np.float32]

_COARSE, _FINE = 65535.0, 1024.0


@dataclass(frozen=True, eq=False)
class Encoded:
    """Numbers as pixels."""

    pixels: Pixels
    offset: NDArray[np.float64]
    scale: NDArray[np.float64]

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Numbers decoded by a shader."""
        largest = {"f": 1, "u": 2 ** (8 * self.pixels.itemsize) - 1}[self.pixels.dtype.kind]
        return np.asarray(self.offset + self.scale * (self.pixels.astype(np.float64) / largest))


def encoded(
    numbers: NDArray[np.floating],
    low: NDArray[np.floating] | float,
    high: NDArray[np.floating] | float,
    kind: Kind,
) -> Encoded:
    """Encode numbers ``(..., channels)`` between two limits of their channels."""
    channels = numbers.shape[-1]
    if kind is np.float32:
        return Encoded(numbers.astype(np.float32), np.zeros(channels), np.ones(channels))
    offset = np.broadcast_to(np.asarray(low, np.float64), channels)
    scale = np.broadcast_to(np.asarray(high, np.float64), channels) - offset
    shares = (numbers - offset) / np.where(scale > 0, scale, 1)
    largest = 255 if kind is np.uint8 else 65535
    whole = np.rint(np.clip(shares, 0, 1) * largest)
    pixels: Pixels = whole.astype(np.uint8) if kind is np.uint8 else whole.astype(np.uint16)
    return Encoded(pixels, offset, scale)


def in_two(numbers: NDArray[np.floating], largest: float, kind: Kind) -> tuple[Encoded, NDArray[np.float64]]:
    """Encode numbers ``(T, n, 3)`` up to a largest magnitude in twice as many rows ``(2 T, n, 3)``.

    Shaders decode :math:`o + s (p + p' / 65535)` with the pixel `p'`, T rows below `p`. It has 6 bits, since more are
    incompressible noise; in EXR it is 0.
    """
    if kind is np.float32:
        made = encoded(np.concatenate([numbers, np.zeros_like(numbers)]), 0, 1, np.float32)
        return made, made.numbers[: len(numbers)]
    steps = np.rint(np.clip((numbers / largest + 1) / 2, 0, 1) * _COARSE**2)
    coarse, fine = np.divmod(steps, _COARSE)
    fine = np.minimum(np.rint(fine / _FINE) * _FINE, _COARSE)
    rows = np.concatenate([coarse, fine]).astype(np.uint16)
    made = Encoded(rows, np.full(3, -largest), np.full(3, 2 * largest))
    return made, -largest + 2 * largest * (coarse + fine / _COARSE) / _COARSE
