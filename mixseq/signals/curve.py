r"""Cubic spline curves over time, given by the points they pass through.

A curve has *knots*: times with a value each. It passes through the values and is a cubic B-spline, two times
continuously differentiable, with not-a-knot ends (its first two pieces are one cubic, and its last two). Through
two knots it is a line, through three a parabola. Values at knots are easy to read and to edit by hand, and the
same curve has the same values whatever knots are added to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline, make_lsq_spline

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.polygons import frozen

Measure = Callable[[Float], Float]
"""From the deviations ``(T, k)`` of a curve to how large they are ``(T,)``."""

CLOSEST = 1e-100
"""Least time between knots, in seconds: what is divided by it three times is still a number. Ours."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A cubic spline through values at knots.

    Attributes
    ----------
    times : (m,) float64
        Knots in seconds, strictly increasing.
    values : (m, k) float64
        Where the curve is at the knots.

    Examples
    --------
    >>> curve = Curve(np.arange(5.0), np.arange(5.0)[:, None] ** 3)
    >>> curve([1.5]).item(), curve.derivative([2.0]).round(12).item()
    (3.375, 12.0)
    """

    times: Float
    values: Float

    def __post_init__(self) -> None:
        times = np.asarray(self.times, dtype=np.float64).reshape(-1)
        values = np.asarray(self.values, dtype=np.float64)
        if values.ndim != 2 or len(values) != len(times) or not len(times):
            raise SettingsError(f"a curve of {len(times)} knots has values of shape {values.shape}")
        apart = np.diff(times)
        if not (np.isfinite(times).all() and np.isfinite(values).all() and (apart > 0).all()):
            raise SettingsError("the knots of a curve must be finite and increase")
        if (apart < CLOSEST).any():
            knot = int(np.argmin(apart))
            raise SettingsError(
                f"knots {knot} and {knot + 1} of a curve are {apart[knot]:g} s apart; {CLOSEST:g} s or more are "
                "expected"
            )
        object.__setattr__(self, "times", frozen(times))
        object.__setattr__(self, "values", frozen(values))

    def __repr__(self) -> str:
        return f"Curve({len(self.times)} knots, {self.start:g} to {self.end:g} s, {self.dim} coordinates)"

    @property
    def start(self) -> float:
        """First knot in seconds."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Last knot in seconds."""
        return float(self.times[-1])

    @property
    def dim(self) -> int:
        """Number k of coordinates."""
        return int(self.values.shape[1])

    @cached_property
    def spline(self) -> BSpline:
        """The curve as a B-spline, knots and control points."""
        return make_interp_spline(self.times, self.values, k=min(3, len(self.times) - 1))

    def __call__(self, times: ArrayLike) -> Float:
        """Return the points ``(N, k)`` at times ``(N,)``; at a knot exactly its value."""
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if not self.dim:
            return np.zeros((len(wanted), 0))
        points = np.asarray(self.spline(wanted), dtype=np.float64).reshape(len(wanted), self.dim)
        nearest = np.clip(np.searchsorted(self.times, wanted), 0, len(self.times) - 1)
        at_knot = self.times[nearest] == wanted
        points[at_knot] = self.values[nearest[at_knot]]
        return points

    def derivative(self, times: ArrayLike, order: int = 1) -> Float:
        """Return derivatives ``(N, k)`` by time, per second (to the power of `order`), at times ``(N,)``."""
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if not self.dim or order > self.spline.k:
            return np.zeros((len(wanted), self.dim))
        slopes = self.spline(wanted, nu=order)
        return np.asarray(slopes, dtype=np.float64).reshape(len(wanted), self.dim)


def fit_curve(times: Float, values: Float, tolerance: float, measure: Measure) -> Curve:
    """Find a curve with few knots that stays near values.

    Parameters
    ----------
    times : (T,) float64
        Times of the values, increasing.
    values : (T, k) float64
        What to stay near.
    tolerance : float
        Largest allowed ``measure(curve(times) - values)``.
    measure : callable
        How large deviations are.

    Returns
    -------
    Curve
        The least-squares spline on knots that were set where it was needed: every interval that holds a value out
        of tolerance is halved. Through all values, if nothing less will do.
    """
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
        if not len(middles):  # what is out of tolerance is next to knots on both sides
            break
        chosen = np.union1d(chosen, middles)
    return Curve(times, values)


def least_squares_curve(times: Float, values: Float, inner: Float) -> Curve:
    """Find the curve with given inner knots that is nearest to values.

    Parameters
    ----------
    times : (T,) float64
        Times of the values, increasing.
    values : (T, k) float64
        What to be near to, in the sense of least squares.
    inner : (n,) float64
        Knots strictly between the first time and the last, increasing, no more than T - 4.
    """
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
