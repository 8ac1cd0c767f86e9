"""Displacement of vertices by rounding points to float32, as in most formats.

A float32 has 24 binary digits: a vertex c diagonals from the origin moves by up to about 1e-7 c diagonals. That is
relevant for meshes that are far away or hardly larger than zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.diagonal import Diagonal
from mixseq.sequence_header import SequenceHeader
from mixseq_io.blocks import warn

VISIBLE = 1e-4
"""Displacement in diagonals that is reported: a fifth of the visually lossless one."""

_FRAMES = 8  # measured at once

_HALF_DIGIT = 2.0**-24, 2.0**-150  # largest rounding error: relative to a coordinate, and near zero


class Rounding:
    """Measures the rounding of points on their way to a float32 file."""

    def __init__(self) -> None:
        self.error, self.frame = 0.0, 0

    def watched(self, blocks: Iterable[FloatArray]) -> Iterator[FloatArray]:
        """Yield blocks ``(B, V, 3)``, measuring each after the writer has checked it."""
        unit, first = None, 0
        for block in blocks:
            yield block
            points = np.asarray(block)
            if points.dtype == np.float32 or not points.size:
                continue
            unit = unit or Diagonal.of(points[0])
            for start in range(0, len(points), _FRAMES):
                self._measure(points[start : start + _FRAMES], first + start, unit)
            first += len(points)

    def _measure(self, points: FloatArray, first: int, unit: Diagonal) -> None:
        relative, least = _HALF_DIGIT
        largest = max(float(points.max()), -float(points.min()))
        if 2 * max(relative * largest, least) < VISIBLE * unit.length:
            return  # the usual case: nothing can be that far off
        with np.errstate(over="ignore", under="ignore"):
            apart: Float = unit.shifted(points - points.astype(np.float32))
            errors = np.sqrt(np.square(apart).sum(axis=2).max(axis=1)) / (unit.fraction or 1.0)
        if errors.max() > self.error:
            self.error, self.frame = float(errors.max()), first + int(errors.argmax())

    def warn(self, path: Path, files: str, header: SequenceHeader) -> None:
        """Warn if vertices are visibly off in files of a kind ("USD")."""
        if self.error > VISIBLE:
            warn(
                f"{path}: {files} holds points in single precision, and vertices are off by up to {self.error:.2g} of "
                f"the diagonal, most in {header.frame_name(self.frame)}; write .npz, .h5 or .ply, which hold "
                "doubles, or move the sequence to the origin"
            )
