"""How well frames are predicted by those before and after: what is known of a curve between its frames."""

from __future__ import annotations

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
