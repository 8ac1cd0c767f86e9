"""Fit curves with few knots to values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_lsq_spline

from mixseq.arrays import Float
from mixseq.signals.curve import Curve

Measure = Callable[[Float], Float]
"""Map of the deviations ``(T, k)`` of a curve to their sizes ``(T,)``."""


def largest(weights: Float) -> Measure:
    """Return the measure of the largest coordinate, with weights ``(k,)``."""
    return lambda deviations: np.asarray(np.abs(deviations * weights).max(axis=1, initial=0.0))


def fit_curve(times: Float, values: Float, tolerance: float, measure: Measure) -> Curve:
    """Fit a curve with few knots to values ``(T, k)`` at times ``(T,)``, within a tolerance."""
    candidates = np.arange(2, len(times) - 2)  # those of the not-a-knot spline through all values
    chosen = np.zeros(0, dtype=np.int64)
    while len(chosen) < len(candidates):
        curve = least_squares_curve(times, values, times[chosen])
        outside = np.flatnonzero(measure(curve(times) - values) > tolerance)
        if not len(outside):
            return curve
        ends = np.concatenate([[1], chosen, [len(times) - 2]])
        intervals = np.unique(np.clip(np.searchsorted(ends, outside) - 1, 0, len(ends) - 2))
        low, high = ends[intervals], ends[intervals + 1]
        middles = ((low + high) // 2)[high - low > 1]
        if not len(middles):  # violations are next to knots on both sides
            break
        chosen = np.union1d(chosen, middles)
    return Curve(times, values)


def least_squares_curve(times: Float, values: Float, inner: Float) -> Curve:
    """Fit a curve with inner knots ``(n,)`` to values ``(T, k)`` at times ``(T,)``, by least squares."""
    first, last = times[0], times[-1]
    if len(times) < 4 or len(inner) >= len(times) - 4:
        return Curve(times, values)
    if len(inner):
        sites = np.concatenate([[first, (first + inner[0]) / 2], inner, [(inner[-1] + last) / 2, last]])
    else:
        sites = np.linspace(first, last, 4)
    if not values.shape[1]:
        return Curve(sites, np.zeros((len(sites), 0)))
    knots = np.concatenate([[first] * 4, inner, [last] * 4])
    return Curve(sites, make_lsq_spline(times, values, knots, k=3)(sites))
