"""Splines over time: interpolation sites, adaptive sampling of other functions, and distances of values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mixseq.arrays import Float
from mixseq.signals.curve import Curve
from mixseq.signals.curve_fitting import Measure, largest
from mixseq.signals.model import Model

ACCURACY = 1e-5
"""Largest error of signals between sites, in diagonals."""

ROUNDS = 6
"""Largest number of times that an interval between two sites is halved."""

EQUAL = 1e-8
"""Distance below which knots are equal, as a fraction of their mean distance."""


def breakpoints(curve: Curve) -> Float:
    """Return the times ``(n,)`` between cubics of the curve: all but the two outermost knots at each end."""
    return curve.times[2:-2]


def between(times: Float, start: float, end: float) -> Float:
    """Return the times strictly between the start and the end."""
    return times[(times > start) & (times < end)]


def sites_of(edges: Float, inner: Float) -> Float:
    """Return sites: breakpoints `edges` ``(n,)`` and `inner` ``(m,)``, and one more in both end intervals."""
    inner = np.unique(inner)
    close = EQUAL * (edges[-1] - edges[0]) / (len(edges) + len(inner))
    after = np.clip(np.searchsorted(edges, inner), 1, len(edges) - 1)
    nearest = np.minimum(np.abs(inner - edges[after - 1]), np.abs(inner - edges[after]))
    inner = inner[nearest > close]
    inner = inner[np.diff(inner, prepend=-np.inf) > close]
    breaks = np.sort(np.concatenate([edges, inner]))
    if len(breaks) == 2:
        return np.linspace(breaks[0], breaks[1], 4)
    return np.sort(np.concatenate([breaks, (breaks[[0, -2]] + breaks[[1, -1]]) / 2]))


def sites_within(model: Model, start: float, end: float, knots: Float | None = None) -> Float:
    """Return sites from `start` to `end`, with frames of the model, breakpoints of its signals, and knots ``(m,)``."""
    if start == end:
        return np.array([start])
    times = [*(breakpoints(curve) for curve in model.curves), model.times]
    inner = np.concatenate(times if knots is None else [*times, knots])
    return sites_of(np.array([start, end]), between(inner, start, end))


def refined(times: Float, parts: int) -> Float:
    """Return times ``(N,)`` with every interval between them divided into `parts`."""
    steps = np.arange(parts) / parts
    between = times[:-1, None] + steps * np.diff(times)[:, None]
    return np.append(between.reshape(-1), times[-1])


def moved(curve: Curve, scale: float, offset: float) -> Curve:
    """Return the curve with times t mapped to ``scale * t + offset``, reversed where the scale is negative."""
    times, values = scale * curve.times + offset, curve.values
    return Curve(times, values) if scale > 0 else Curve(times[::-1], values[::-1])


def sampled(function: Callable[[Float], Float], sites: Float, tolerance: float, measure: Measure) -> Curve:
    """Return the spline through a function of time, with sites ``(m,)`` refined until the tolerance holds."""
    for _ in range(ROUNDS):
        both = np.empty(2 * len(sites) - 1)
        both[::2], both[1::2] = sites, (sites[:-1] + sites[1:]) / 2
        values = function(both)
        curve, middles = Curve(sites, values[::2]), both[1::2]
        off = measure(curve(middles) - values[1::2]) > tolerance
        if not off.any():
            return curve
        sites = np.union1d(sites, middles[off])
    return Curve(sites, function(sites))


def shape_measure(model: Model, metric: Float | None = None) -> Measure:
    """Return a measure of steps ``(N, k)`` in pose space: RMS over vertices in diagonals, by weights ``(S,)``."""
    shapes = model.shapes
    metric = model.space.shape_weights if metric is None else metric
    steps = model.pose.matrix @ (shapes - shapes[0]) * metric
    gram = steps @ steps.T / model.header.vertex_count
    return lambda changes: np.sqrt(np.maximum(np.einsum("na,ab,nb->n", changes, gram, changes), 0.0))


def placement_measure(model: Model) -> Measure:
    """Return the size ``(N,)`` of placement changes ``(N, P)``: the largest component, in diagonals."""
    return largest(model.space.weights[model.space.shape_dim :][: model.space.placement_dim])


def correction_measure(model: Model) -> Measure:
    """Return the size ``(N,)`` of correction changes ``(N, C)``: the largest component, in diagonals."""
    return largest(model.space.weights[model.space.shape_dim + model.space.placement_dim :])
