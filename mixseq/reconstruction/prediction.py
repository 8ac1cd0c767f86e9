"""How well frames are predicted by those before and after: what is known of a curve between its frames."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def prediction_errors(curves: Float) -> Float:
    """Return how far frames of curves ``(T, k, c)`` are from what their neighbours predict, frame by frame.

    By the cubic through four of them, a straight line where there are fewer than five frames, the other frame where
    there are two.

    Returns
    -------
    (N, k, c) float64
        Errors of the N frames that are predicted; zeros for a single frame.
    """
    c = curves
    if len(c) >= 5:
        return np.asarray((4.0 * (c[1:-3] + c[3:-1]) - c[:-4] - c[4:]) / 6.0 - c[2:-2])
    if len(c) >= 3:
        return np.asarray((c[:-2] + c[2:]) / 2.0 - c[1:-1])
    return c[1:] - c[:-1] if len(c) == 2 else np.zeros_like(c)


def mean_squared_errors(curves: Float) -> Float:
    """Return the mean over the frames of the squared errors ``(k,)`` of `prediction_errors`."""
    return np.asarray(np.square(prediction_errors(curves)).sum(axis=2).mean(axis=0))


class SquaredErrors:
    """The mean of `mean_squared_errors`, of curves that come frame by frame.

    Parameters
    ----------
    frames : int
        How many frames T will come.
    """

    def __init__(self, frames: int) -> None:
        self._window: deque[Float] = deque(maxlen=5 if frames >= 5 else min(frames, 3))
        self._sum: Float | None = None
        self._count = 0

    def add(self, frame: Float) -> None:
        """Take the next frame ``(k, c)``."""
        self._window.append(frame)
        if len(self._window) == self._window.maxlen:
            error = np.square(prediction_errors(np.stack(self._window))).sum(axis=2)[0]
            self._sum = error if self._sum is None else self._sum + error
            self._count += 1

    def mean(self) -> Float:
        """Return the mean ``(k,)`` of all squared errors."""
        assert self._sum is not None, "frames have come"
        return np.asarray(self._sum / self._count)
