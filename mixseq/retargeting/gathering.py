"""Sums and largest values of frames that pass by, in little memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

PERCENTILE = 0.999


@dataclass(frozen=True)
class Strain:
    """Strains of all edges in all frames: root mean square, 99.9th percentile, and the largest."""

    rms: float
    p999: float
    max: float


class Acceleration:
    """Second differences of frames that come in blocks."""

    def __init__(self) -> None:
        self._before: Float | None = None
        self._squares, self._seen, self._largest, self._done = 0.0, 0, 0.0, 0
        self.worst_frame = 0

    def add(self, block: Float) -> None:
        """Take the next frames ``(B, V, 3)``."""
        whole = block if self._before is None else np.concatenate([self._before, block])
        for number in range(1, len(whole) - 1):
            before, here, after = whole[number - 1 : number + 2]
            squares = np.square(after - 2.0 * here + before).sum(axis=1)
            self._squares += float(squares.sum())
            self._seen += len(squares)
            self._done += 1  # the first difference is about frame 1
            if squares.max() > self._largest:
                self._largest, self.worst_frame = float(squares.max()), self._done
        self._before = whole[-2:]

    @property
    def rms(self) -> float:
        """Root mean square over all vertices and frames."""
        return float(np.sqrt(self._squares / max(self._seen, 1)))

    @property
    def max(self) -> float:
        """The largest."""
        return float(np.sqrt(self._largest))


class Strains:
    """Root mean square and percentile of many values, of which only the largest are kept; NaN is left out.

    Parameters
    ----------
    total : int
        How many values there will be at most.
    """

    def __init__(self, total: int) -> None:
        self._keep = total - int(PERCENTILE * total) + 1
        self._kept = np.zeros(0)
        self._squares, self._seen = 0.0, 0

    def add(self, values: Float) -> None:
        """Take more values, none of them negative."""
        values = values[np.isfinite(values)]
        self._squares += float(np.square(values).sum())
        self._seen += len(values)
        self._kept = np.sort(np.concatenate([self._kept, values]))[-self._keep :]

    def result(self) -> Strain:
        """Return what all values amount to; zeros if there were none."""
        if not self._seen:
            return Strain(0.0, 0.0, 0.0)
        above = self._seen - int(np.ceil(PERCENTILE * self._seen))
        rms = float(np.sqrt(self._squares / self._seen))
        return Strain(rms, float(self._kept[-1 - above]), float(self._kept[-1]))
