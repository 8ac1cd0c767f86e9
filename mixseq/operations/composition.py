r"""Retime: a motion along a map of time, as a model.

With a map r from times of the output to times of the source (`mixseq.operations.retime`) every signal y becomes

.. math:: y_\text{out}(o) = y(r(o)), \qquad \dot y_\text{out}(o) = r'(o)\, \dot y(r(o)).

Where r is straight this is a cubic spline, whose knots are the times at which r passes those of y. Elsewhere it is no
spline, and the one through enough of its points stands for it: through the keys, the times at which r passes knots,
and what it takes between these. Next to a kink of r, points are dense: the distances to it double from one to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.operations.passes import SLACK
from mixseq.operations.pieces import between, breakpoints, sites_of
from mixseq.operations.retime import Retiming
from mixseq.operations.sampling import placement_measure, sampled, shape_measure
from mixseq.pickling import PickledWithoutCaches
from mixseq.signals.curve import Curve, Measure
from mixseq.signals.model import MOST_FRAMES, Model, ResidualLayer

ACCURACY = 2e-6
"""Largest error, in diagonals, of the splines between sites: in joints vertices may be off by many times more. Ours."""

DOUBLINGS = 10
"""So often distances to a kink double, up to half the distance to the next key."""


def retime(model: Model, keys: ArrayLike, smooth: bool = True) -> Model:
    """Return the model faster and slower, backwards or standing still, along a map of time.

    As `mixseq.operations.resample` with a `Retiming`, but the result is a model.
    The residual layer is retimed with the signals.

    Parameters
    ----------
    model : Model
        The source.
    keys : (n, 2) array_like
        Points of the map: a time of the output and the time of the source that it shows, in seconds; two points or
        more, output times increasing.
    smooth : bool
        Join the points by a curve whose slope is continuous, else by straight lines, see `Retiming.through`.

    Returns
    -------
    Model
        From the first output time to the last, with frames from the first one on at the rate of the model.

    Raises
    ------
    SettingsError
        If the keys are no retiming, ask for times outside the model, or make too many frames.
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
    frames = _frames(model, retiming)

    dense = np.zeros(0) if smooth else _near_kinks(outputs, sources)
    time = _composed(model, model.time, retiming, dense, shape_measure(model))
    placement = _composed(model, model.placement, retiming, dense, placement_measure(model))
    layer = model.residual_layer
    retimed = None if layer is None else RetimedLayer(layer, retiming)
    return model.with_motion(time, placement, model.header.with_times(frames), retimed)


def _frames(model: Model, retiming: Retiming) -> Float:
    lasting, fps = retiming.end - retiming.start, model.header.fps
    if lasting * fps >= MOST_FRAMES:
        raise SettingsError(
            f"the output lasts {lasting:g} s, which makes more than {MOST_FRAMES:,} frames; give less"
        )
    frames = retiming.start + np.arange(int(np.floor(lasting * fps + SLACK)) + 1) / fps
    return np.asarray(np.minimum(frames, retiming.end))


def _composed(model: Model, curve: Curve, retiming: Retiming, dense: Float, measure: Measure) -> Curve:
    """A signal of the model along the map; `dense` are times that are sites in any case."""
    keys = retiming.curve.x
    passed = [retiming.curve.solve(knot, extrapolate=False) for knot in breakpoints(curve)]
    inner = np.concatenate([dense, *passed])  # with NaN where the source stands still
    sites = sites_of(keys, between(inner, retiming.start, retiming.end))
    return sampled(lambda at: curve(model.inside(retiming(at))), sites, ACCURACY, measure)


def _near_kinks(outputs: Float, sources: Float) -> Float:
    """Times on both sides of the keys where the slope of straight lines jumps."""
    slopes = np.diff(sources) / np.diff(outputs)
    kinks = 1 + np.flatnonzero(np.abs(np.diff(slopes)) > 1e-9 * np.abs(slopes).max())
    away = 0.5 ** np.arange(1, DOUBLINGS + 1)
    before = outputs[kinks, None] + (outputs[kinks - 1] - outputs[kinks])[:, None] * away
    after = outputs[kinks, None] + (outputs[kinks + 1] - outputs[kinks])[:, None] * away
    return np.concatenate([before, after]).reshape(-1)


@dataclass(frozen=True, eq=False)
class RetimedLayer(PickledWithoutCaches):
    """A residual layer along a map of time.

    Attributes
    ----------
    source : ResidualLayer
        The layer by times of the source.
    retiming : Retiming
        The map.
    """

    source: ResidualLayer
    retiming: Retiming

    def at(self, times: Float) -> Float:
        """Return displacements ``(N, V, 3)`` at times ``(N,)`` in seconds."""
        return self.source.at(self.retiming(times))

    def rates(self, times: Float) -> Float:
        """Return the derivatives ``(N, V, 3)`` of the displacements by time, per second."""
        slopes = self.retiming.slope(times)
        return np.asarray(slopes[:, None, None] * self.source.rates(self.retiming(times)))
