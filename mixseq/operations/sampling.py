"""Curves through functions of time that are no splines, and how far apart two points of pose space are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mixseq.arrays import Float
from mixseq.signals.curve import Curve, Measure
from mixseq.signals.model import Model

ROUNDS = 6
"""An interval between two sites is halved at most so often."""


def sampled(function: Callable[[Float], Float], sites: Float, tolerance: float, measure: Measure) -> Curve:
    """Return the spline through a function of time, with as many sites as it takes.

    Parameters
    ----------
    function : callable
        From increasing times ``(N,)`` to values ``(N, k)``.
    sites : (m,) float64
        Times that are sites in any case. Intervals in whose middle the spline is too far off are halved, but not
        for ever: functions may have kinks.
    tolerance : float
        Largest allowed ``measure(spline - function)`` in the middle of an interval.
    measure : callable
        From deviations ``(N, k)`` to how large they are ``(N,)``.
    """
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
    """Return how long steps ``(N, k)`` in pose space are ``(N,)``: root mean square over the vertices, in diagonals.

    With the weights of the space, or with others ``(S,)``.
    """
    shapes = model.shapes
    metric = model.space.shape_weights if metric is None else metric
    steps = model.pose.matrix @ (shapes - shapes[0]) * metric
    gram = steps @ steps.T / model.header.vertex_count
    return lambda changes: np.sqrt(np.maximum(np.einsum("na,ab,nb->n", changes, gram, changes), 0.0))


def placement_measure(model: Model) -> Measure:
    """Return how large changes ``(N, P)`` of a placement are ``(N,)``: the largest number, in diagonals."""
    metric = model.space.weights[model.space.shape_dim :]
    return lambda changes: np.abs(changes * metric).max(axis=1, initial=0.0)
