r"""Retiming: maps from output time to source time, and models composed with such maps.

.. math:: s = r(o), \qquad y_\text{out}(o) = y(r(o)), \qquad \dot y_\text{out}(o) = r'(o)\, \dot y(r(o))

for frames, and for all signals y of a model. Both times are in seconds. Where the map :math:`r` falls, the source runs
backwards; where it is level, the source stands still. Its slope :math:`r'` is the speed of the source.

Where r is linear, a retimed signal is a cubic spline whose knots are the output times at which r passes knots of y.
Elsewhere it is approximated by a spline through the keys, the times at which r passes knots, and further sites between
these. Sites are dense next to a kink of r: their distances to it double from one to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator, PPoly

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.operations.joining import SLACK
from mixseq.operations.splines import (
    between,
    breakpoints,
    correction_measure,
    placement_measure,
    sampled,
    shape_measure,
    sites_of,
)
from mixseq.pickling import PickledWithoutCaches
from mixseq.public import public
from mixseq.sequence_header import frame_times
from mixseq.signals.curve import CLOSEST, Curve
from mixseq.signals.curve_fitting import Measure
from mixseq.signals.decoding import ResidualLayer
from mixseq.signals.model import Model

ACCURACY = 2e-6
"""Largest error of the splines between sites, in diagonals; errors of vertices in joints may be many times larger."""

DOUBLINGS = 10
"""Number of times that the distance to a kink doubles, up to half the distance to the next key."""


@dataclass(frozen=True, eq=False)
class Retiming:
    """A map from times of the output to times of the source.

    Make it with `through`, `section` or `hold`, or read it from a file with `read_retiming`.

    Attributes
    ----------
    start, end : float
        First and last time of the output, in seconds.
    curve : scipy.interpolate.PPoly
        Times of the source, a piecewise polynomial of the time of the output.

    Examples
    --------
    >>> slow = Retiming.section(1.0, 2.0, speed=0.5)
    >>> slow.start, slow.end, slow([1.0, 2.0, 3.0]).tolist(), slow.slope([2.0]).item()
    (1.0, 3.0, [1.0, 1.5, 2.0], 0.5)
    """

    start: float
    end: float
    curve: PPoly

    @classmethod
    def through(cls, outputs: ArrayLike, sources: ArrayLike, smooth: bool = True) -> Retiming:
        """Make the map through points.

        Parameters
        ----------
        outputs : (n,) array_like
            Times of the output in seconds, increasing.
        sources : (n,) array_like
            Times of the source in seconds.
        smooth : bool
            Interpolate by Fritsch and Carlson's monotone cubic, with a continuous slope; else linearly.

        Raises
        ------
        SettingsError
            If there are fewer than two points, times are not finite, too close or too large, or outputs do not
            increase.
        """
        x, y = np.asarray(outputs, dtype=np.float64), np.asarray(sources, dtype=np.float64)
        if x.ndim != 1 or x.shape != y.shape or len(x) < 2:
            raise SettingsError(
                f"a retiming has {x.size} output times and {y.size} source times; two of each, or more, are expected"
            )
        if not (np.isfinite(x).all() and np.isfinite(y).all() and (np.diff(x) > 0).all()):
            raise SettingsError("the times of a retiming must be finite, and its output times increase")
        if np.diff(x).min() < CLOSEST or max(np.abs(x).max(), np.abs(y).max()) > 1 / CLOSEST:
            raise SettingsError(
                f"the output times of a retiming must be {CLOSEST:g} s apart or more, and no time beyond "
                f"{1 / CLOSEST:g} s"
            )
        lines = np.stack([np.diff(y) / np.diff(x), y[:-1]])
        return cls(float(x[0]), float(x[-1]), PchipInterpolator(x, y) if smooth else PPoly(lines, x))

    @classmethod
    def section(cls, start: float, end: float, speed: float = 1.0, reverse: bool = False) -> Retiming:
        """Make the map that shows the source from `start` to `end` at a constant speed, forwards or backwards.

        The output also begins at `start`. SettingsError if the end is before the start, or the speed is not positive.
        """
        if not (np.isfinite(start) and np.isfinite(end) and start <= end):
            raise SettingsError(f"there is no time between the start, {start:g} s, and the end, {end:g} s")
        if not (np.isfinite(speed) and speed > 0):
            raise SettingsError(f"speed is {speed:g}; a positive number is expected (1 keeps the speed)")
        first, slope = (end, -speed) if reverse else (start, speed)
        return cls(start, start + (end - start) / speed, _line(first - slope * start, slope))

    @classmethod
    def hold(cls, source: float, start: float, end: float) -> Retiming:
        """Make the map that shows one time of the source from `start` to `end` of the output.

        Raises `SettingsError` if the end is before the start, or a time is not finite.
        """
        if not (np.isfinite([source, start, end]).all() and start <= end):
            raise SettingsError(f"{source:g} s cannot be held from {start:g} to {end:g} s")
        return cls(start, end, _line(source, 0.0))

    def __call__(self, times: ArrayLike) -> Float:
        """Return source times ``(N,)`` at output times ``(N,)``; SettingsError for times outside the retiming."""
        return np.asarray(self.curve(self._inside(times)), dtype=np.float64)

    def slope(self, times: ArrayLike) -> Float:
        """Return seconds of the source per second of the output ``(N,)``; at a kink, the slope after it."""
        return np.asarray(self.curve(self._inside(times), nu=1), dtype=np.float64)

    def _inside(self, times: ArrayLike) -> Float:
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        outside = ~((wanted >= self.start) & (wanted <= self.end))
        if outside.any():
            raise SettingsError(
                f"the retiming is from {self.start:g} to {self.end:g} s of the output, and tells nothing of "
                f"{wanted[outside][0]:g} s"
            )
        return wanted


def _line(origin: float, slope: float) -> PPoly:
    return PPoly(np.array([[slope], [origin]]), np.array([0.0, 1.0]))  # beyond which it goes on


@public
def retime(model: Model, keys: ArrayLike, smooth: bool = True) -> Model:
    """Return the model faster and slower, backwards or standing still, along a map of time.

    As `mixseq.operations.resample` with a `Retiming`, but the result is a model. The residual layer is retimed with the
    signals.

    Parameters
    ----------
    model : Model
        The source.
    keys : (n, 2) array_like
        Two or more points of the map: output times, increasing, and the source times shown then, in seconds.
    smooth : bool
        Interpolate with a continuous slope, else linearly, see `Retiming.through`.

    Returns
    -------
    Model
        From the first to the last output time, with frames from the first on at the rate of the model.

    Raises
    ------
    SettingsError
        If the keys are no retiming, contain times outside the model, or make too many frames.
    """
    points = np.asarray(keys, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise SettingsError(
            f"keys have shape {points.shape}; (n, 2) is expected, pairs of a time of the output and one of the source"
        )
    outputs, sources = points.T
    retiming = Retiming.through(outputs, sources, smooth)
    try:
        model.inside(sources)  # between the keys the map is between them, too
    except SettingsError as error:
        raise SettingsError(f"the retiming asks for more than there is: {error}") from None
    frames = frame_times(retiming.start, retiming.end, model.header.fps, SLACK)

    dense = np.zeros(0) if smooth else _near_kinks(outputs, sources)
    time = _composed(model, model.time, retiming, dense, shape_measure(model))
    placement = _composed(model, model.placement, retiming, dense, placement_measure(model))
    correction = _composed(model, model.correction, retiming, dense, correction_measure(model))
    layer = model.residual_layer
    retimed = None if layer is None else RetimedLayer(layer, retiming)
    return model.with_motion(time, placement, correction, model.header.with_times(frames), retimed)


def _composed(model: Model, curve: Curve, retiming: Retiming, dense: Float, measure: Measure) -> Curve:
    """Return a signal of the model composed with the map; `dense` are additional sites ``(m,)``."""
    keys = retiming.curve.x
    passed = [retiming.curve.solve(knot, extrapolate=False) for knot in breakpoints(curve)]
    inner = np.concatenate([dense, *passed])  # with NaN where the source stands still
    sites = sites_of(keys, between(inner, retiming.start, retiming.end))
    return sampled(lambda at: curve(model.inside(retiming(at))), sites, ACCURACY, measure)


def _near_kinks(outputs: Float, sources: Float) -> Float:
    """Return times on both sides of the keys where the slope of a piecewise linear map jumps."""
    slopes = np.diff(sources) / np.diff(outputs)
    kinks = 1 + np.flatnonzero(np.abs(np.diff(slopes)) > 1e-9 * np.abs(slopes).max())
    away = 0.5 ** np.arange(1, DOUBLINGS + 1)
    before = outputs[kinks, None] + (outputs[kinks - 1] - outputs[kinks])[:, None] * away
    after = outputs[kinks, None] + (outputs[kinks + 1] - outputs[kinks])[:, None] * away
    return np.concatenate([before, after]).reshape(-1)


@dataclass(frozen=True, eq=False)
class RetimedLayer(PickledWithoutCaches):
    """A residual layer composed with a retiming."""

    source: ResidualLayer  # the layer in source time
    retiming: Retiming  # map from output time to source time

    def at(self, times: Float) -> Float:
        """Return displacements ``(N, V, 3)`` at times ``(N,)`` in seconds."""
        return self.source.at(self.retiming(times))

    def rates(self, times: Float) -> Float:
        """Return the derivatives ``(N, V, 3)`` of the displacements by time, per second."""
        slopes = self.retiming.slope(times)
        return np.asarray(slopes[:, None, None] * self.source.rates(self.retiming(times)))
