"""The diagonal of a bounding box, the unit of lengths and errors, at any scale.

Squares of lengths below 1e-154 or above 1e154 overflow double precision, so exponents are shifted before squaring.
Results are bitwise equal wherever squares fit anyway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray


@dataclass(frozen=True)
class Diagonal:
    """The diagonal of the bounding box of a frame, ``fraction * 2**exponent``."""

    fraction: float  # from 0.5 to 2, or 0 if all points are one
    exponent: int  # the power of two

    @classmethod
    def of(cls, points: FloatArray) -> Diagonal:
        """Measure the bounding box of points ``(V, 3)``."""
        low, high = (
            np.asarray(corner, dtype=np.float64) for corner in (points.min(axis=0), points.max(axis=0))
        )
        halved = 1 if max(np.abs(low).max(), np.abs(high).max()) > np.finfo(np.float64).max / 2 else 0
        extent = np.ldexp(high, -halved) - np.ldexp(low, -halved)
        if not extent.any():
            return cls(0.0, 0)
        _, exponent = np.frexp(extent.max())
        return cls(float(np.linalg.norm(np.ldexp(extent, -exponent))), int(exponent) + halved)

    @property
    def length(self) -> float:
        """Length in the units of the points; infinite on overflow."""
        with np.errstate(over="ignore"):
            return float(np.ldexp(self.fraction, self.exponent))

    def shifted(self, lengths: FloatArray) -> Float:
        """Return lengths divided by ``2**exponent``, which brings those near the diagonal near `fraction`."""
        with np.errstate(over="ignore", under="ignore"):
            return np.asarray(np.ldexp(lengths, -self.exponent), dtype=np.float64)
