"""Accelerations of frames that pass by, in little memory."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float


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
