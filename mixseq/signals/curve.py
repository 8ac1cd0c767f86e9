"""Cubic spline curves over time that pass through given values at knots.

A curve has *knots*: times with a value each. It is a twice continuously differentiable cubic B-spline through the
values. At each not-a-knot end, two pieces are one cubic. With two knots the curve is a line, with three a parabola.
Values at knots can be edited by hand, independently of the other knots.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.mesh.polygons import read_only
from mixseq.types import Float

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


MIN_KNOT_SPACING = 1e-100
"""Least time between knots in seconds; in double precision its third power is still a valid divisor."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A cubic spline through values at knots.

    Attributes
    ----------
    times : (m,) float64
        Knots in seconds, strictly increasing.
    values : (m, k) float64
        Values at the knots.

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
        spacings = np.diff(times)
        if not (np.isfinite(times).all() and np.isfinite(values).all() and (spacings > 0).all()):
            raise SettingsError("the knots of a curve must be finite and increase")
        if (spacings < MIN_KNOT_SPACING).any():
            knot = int(np.argmin(spacings))
            raise SettingsError(
                f"knots {knot} and {knot + 1} of a curve are {spacings[knot]:g} s apart; "
                f"{MIN_KNOT_SPACING:g} s or more are expected"
            )
        object.__setattr__(self, "times", read_only(times))
        object.__setattr__(self, "values", read_only(values))

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
        """The curve as a B-spline of knots and control points."""
        from scipy.interpolate import make_interp_spline  # slow import, unused at knots

        return make_interp_spline(self.times, self.values, k=min(3, len(self.times) - 1))

    def __call__(self, times: ArrayLike) -> Float:
        """Return the points ``(N, k)`` of the curve at times ``(N,)``; at knots exactly the given values."""
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if not self.dim:
            return np.zeros((len(times), 0))
        knots = np.clip(np.searchsorted(self.times, times), 0, len(self.times) - 1)
        points = self.values[knots]
        is_between = self.times[knots] != times
        if is_between.any():
            points[is_between] = self.spline(times[is_between])
        return points

    def derivative(self, times: ArrayLike, order: int = 1) -> Float:
        """Return the time derivatives ``(N, k)`` of an order at times ``(N,)``, per second to the power of `order`."""
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if not self.dim or order > self.spline.k:
            return np.zeros((len(times), self.dim))
        slopes = self.spline(times, nu=order)
        return np.asarray(slopes, dtype=np.float64).reshape(len(times), self.dim)
