r"""Cubic spline curves over time that pass through given values at knots.

A curve has *knots*: times with a value each. It is a twice continuously differentiable cubic spline through the
values. At each not-a-knot end, two pieces are one cubic. With two knots the curve is a line, with three a parabola.
Values at knots can be edited by hand, independently of the other knots. With knots :math:`h_i` apart and secants
:math:`d_i` between them, the slopes :math:`m_i` at four or more knots are (de Boor, A Practical Guide to Splines, IV)

.. math:: h_i m_{i-1} + 2 (h_{i-1} + h_i) m_i + h_{i-1} m_{i+1} = 3 (h_i d_{i-1} + h_{i-1} d_i), \qquad
   h_1 m_0 + (h_0 + h_1) m_1 = \frac{(3 h_0 + 2 h_1) h_1 d_0 + h_0^2 d_1}{h_0 + h_1} .

A time given twice *breaks* the curve: a spline ends there with the first value, and another begins with the second. The
curve jumps if both values differ, and has a corner if they are equal. At the break it has the second value.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.mesh.measures import element_blocks
from mixseq.mesh.polygons import read_only
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.low_memory import LargeArray, from_columns
from mixseq.types import Float

MIN_KNOT_SPACING = 1e-100  # least time between knots in seconds, whose third power is still a valid divisor


@dataclass(frozen=True, eq=False)
class Curve(PickledWithoutCaches):
    """A cubic spline through values at knots.

    Attributes
    ----------
    times : (m,) float64
        Knots in seconds, increasing; inner knots may be given twice, where the curve breaks.
    values : (m, k) float64
        Values at the knots.

    Examples
    --------
    >>> curve = Curve(np.arange(5.0), np.arange(5.0)[:, None] ** 3)
    >>> curve([1.5]).round(12).item(), curve.derivative([2.0]).round(12).item()
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
        if not (np.isfinite(times).all() and np.isfinite(values).all() and is_increasing(times)):
            raise SettingsError("the knots of a curve must be finite and increase")
        if ((spacings > 0) & (spacings < MIN_KNOT_SPACING)).any():
            knot = int(np.argmin(np.where(spacings > 0, spacings, np.inf)))
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

    @property
    def breaks(self) -> Float:
        """Times ``(b,)`` at which the curve breaks."""
        return np.asarray(self.times[1:][np.diff(self.times) == 0])

    @property
    def pieces(self) -> tuple[Curve, ...]:
        """The splines between the breaks."""
        return self._split or (self,)

    @cached_property
    def _split(self) -> tuple[Curve, ...]:
        """The pieces of a curve with breaks; none without, as a curve that holds itself is not freed at once."""
        starts = np.flatnonzero(np.diff(self.times) == 0) + 1
        return tuple(map(Curve, np.split(self.times, starts), np.split(self.values, starts))) if len(starts) else ()

    @classmethod
    def from_pieces(cls, pieces: Iterable[Curve]) -> Curve:
        """Concatenate curves, each of which begins where the one before ends."""
        times, values = zip(*((piece.times, piece.values) for piece in pieces), strict=True)
        return cls(np.concatenate(times), np.concatenate(values))

    @cached_property
    def slopes(self) -> LargeArray:
        """Slopes ``(m, k)`` at the knots of a curve without breaks, on disk if they are large."""
        return from_columns(self.values.shape, lambda columns: self._solve_for_slopes(self.values[:, columns]))

    def _solve_for_slopes(self, values: Float) -> Float:
        h = np.diff(self.times)[:, None]
        if len(h) < 3:  # a line or a parabola
            secants = np.diff(values, axis=0) / h
            bend = np.diff(secants, axis=0).sum(axis=0) / h.sum()
            starts = secants[:1] - bend * h[:1]
            return np.concatenate([starts, secants + bend * h])
        below, diagonal, above = np.zeros((3, len(self.times)))
        right = np.empty(values.shape)
        below[1:-1], diagonal[1:-1], above[1:-1] = h[1:, 0], 2 * (h[:-1, 0] + h[1:, 0]), h[:-1, 0]
        for rows in element_blocks(len(h) - 1, values.shape[1]):
            secants = np.diff(values[rows.start : rows.stop + 2], axis=0) / h[rows.start : rows.stop + 1]
            right[1:-1][rows] = 3 * (h[1:][rows] * secants[:-1] + h[:-1][rows] * secants[1:])
        for end, beside, next_to in ((0, 1, above), (-1, -2, below)):
            three = slice(None, 3) if end == 0 else slice(-3, None)
            secants = np.diff(values[three], axis=0) / np.diff(self.times[three])[:, None]
            both = h[end, 0] + h[beside, 0]
            diagonal[end], next_to[end] = h[beside, 0], both
            right[end] = (h[end] + 2 * both) * h[beside] / both * secants[end] + h[end] ** 2 / both * secants[beside]
        return _solve_tridiagonal(below, diagonal, above, right)

    def __call__(self, times: ArrayLike) -> Float:
        """Return the points ``(N, k)`` of the curve at times ``(N,)``; at knots exactly the given values."""
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if not self.dim:
            return np.zeros((len(times), 0))
        knots = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 1)
        points = self.values[knots]
        is_between = self.times[knots] != times
        if is_between.any():
            points[is_between] = self._evaluate(times[is_between], 0)
        return points

    def on_both_sides(self, times: Float) -> Float:
        """Return the points ``(N, k)`` at increasing times; of a break given twice, first the end of the spline."""
        points = self(times)
        is_end = np.append(times[:-1] == times[1:], False)
        knots = np.searchsorted(self.times, times[is_end], side="left")
        points[is_end] = self.values[knots]
        return points

    def derivative(self, times: ArrayLike, order: int = 1) -> Float:
        """Return the time derivatives ``(N, k)`` of an order at times ``(N,)``, per second to the power of `order`."""
        times = np.atleast_1d(np.asarray(times, dtype=np.float64))
        return self._evaluate(times, order) if self.dim else np.zeros((len(times), 0))

    def _evaluate(self, times: Float, order: int) -> Float:
        """Return values or derivatives ``(N, k)`` of the splines at times ``(N,)``."""
        result = np.zeros((len(times), self.dim))
        piece_ids = np.searchsorted(self.breaks, times, side="right")
        for number in np.unique(piece_ids):
            mask = piece_ids == number
            result[mask] = self.pieces[number]._evaluate_spline(times[mask], order)
        return result

    def _evaluate_spline(self, times: Float, order: int) -> Float:
        """Evaluate a curve without breaks, see `_evaluate`."""
        degree = min(3, len(self.times) - 1)
        if order > degree or not degree:
            return self.values[np.zeros(len(times), dtype=int)] * (order == 0)
        knots = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        h, offset = (each[:, None] for each in (self.times[knots + 1] - self.times[knots], times - self.times[knots]))
        secants = (self.values[knots + 1] - self.values[knots]) / h
        slopes = self.slopes[knots]
        start, end = slopes - secants, self.slopes[knots + 1] - secants
        powers = self.values[knots], slopes, -(2 * start + end) / h, (start + end) / h**2
        result = np.zeros(secants.shape)
        for power in range(3, order - 1, -1):
            result = result * offset + math.perm(power, order) * powers[power]
        return result


def _solve_tridiagonal(below: Float, diagonal: Float, above: Float, right: Float) -> Float:
    """Solve for ``(m, k)`` in place. Rows are diagonally dominant; SciPy takes as long to import as a file to load."""
    for row in range(1, len(right)):
        factor = below[row] / diagonal[row - 1]
        diagonal[row] -= factor * above[row - 1]
        right[row] -= factor * right[row - 1]
    right[-1] /= diagonal[-1]
    for row in range(len(right) - 2, -1, -1):
        right[row] = (right[row] - above[row] * right[row + 1]) / diagonal[row]
    return right


def is_increasing(times: Float) -> bool:
    """Whether times ``(m,)`` increase, where inner times may be given twice."""
    repeats = np.flatnonzero(np.diff(times) == 0)
    is_inner = (repeats > 0) & (repeats < len(times) - 2)
    return bool((np.diff(times) >= 0).all() and is_inner.all() and (np.diff(repeats) > 1).all())
