"""Running statistics of streamed values in little memory: root mean square, 99.9th percentile, maximum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float

PERCENTILE = 0.999


@dataclass(frozen=True)
class Statistics:
    """Statistics of one error over all elements and frames."""

    rms: float  # root mean square
    p999: float  # 99.9th percentile: the smallest value that 99.9 % do not exceed
    max: float  # largest value
    skipped: int  # how many values are not defined and were left out, counted over all frames


class RunningStatistics:
    """Accumulate `Statistics` block by block, from the sum of squares and the largest values."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._count = 0
        self._squares = 0.0
        self._keep = total - int(PERCENTILE * total) + 1
        self._largest = np.zeros(0)

    def add(self, values: Float) -> None:
        """Add non-negative values ``(n,)``; those that are not finite are skipped."""
        values = values[np.isfinite(values)]
        self._count += values.size
        self._squares += float(np.square(values).sum())
        if len(self._largest) == self._keep:
            values = values[values > self._largest[0]]
        largest = np.concatenate([self._largest, values])
        if len(largest) >= self._keep:
            # Partitioned so that the smallest of those kept comes first.
            largest = np.partition(largest, len(largest) - self._keep)[-self._keep :]
        self._largest = largest

    def result(self) -> Statistics:
        """Return the statistics of all values; zeros for none."""
        if not self._count:
            return Statistics(rms=0.0, p999=0.0, max=0.0, skipped=self._total)
        above = self._count - int(np.ceil(PERCENTILE * self._count))
        return Statistics(
            rms=float(np.sqrt(self._squares / self._count)),
            p999=float(np.sort(self._largest)[-1 - above]),
            max=float(self._largest.max()),
            skipped=self._total - self._count,
        )
