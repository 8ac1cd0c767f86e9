"""The unit of lengths and errors, the diagonal of a bounding box, and lengths in it at any scale.

Squares of lengths below 1e-154 or above 1e154 do not fit into a double. So exponents are shifted before lengths are
squared. That changes no digit: wherever squares fit anyway, results are the same to the last bit.
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
        """Measure points ``(V, 3)``."""
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
        """The length in the units of the points; infinite if it does not fit."""
        with np.errstate(over="ignore"):
            return float(np.ldexp(self.fraction, self.exponent))

    def shifted(self, lengths: FloatArray) -> Float:
        """Return lengths over ``2**exponent``: of the size of `fraction` if they are of that of the diagonal."""
        with np.errstate(over="ignore", under="ignore"):
            return np.asarray(np.ldexp(lengths, -self.exponent), dtype=np.float64)
