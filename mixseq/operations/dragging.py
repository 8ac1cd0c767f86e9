r"""Drag: pull a point of the time curve in the embedding; the motion around it follows.

The pose at a place is interpolated from the pulled point and from frames spread over the plane, by the cardinal weights
of `mixseq.operations.sketch`: :math:`c^*(y)`. The correction is interpolated by the same weights, so a point that is
pulled to one of these frames becomes that frame. Of two frames that are close in the plane and far apart in pose space,
which would make :math:`c^*` steep, one is left out.

The embedding of a model (`Model.embedding`) is affine in pose space, :math:`y(t) = A^T (c(t) - \bar c)`. Where the
interpolated pose misses the place by :math:`\Delta y`, the step of least shape change is along the two principal
directions P of the plane (`mixseq.signals.mds_embedding`),

.. math:: \delta = c^*(y) - c^*(y(t_0)) + P\, (A^T P)^+ \Delta y .

The change fades out on both sides,

.. math:: c(t) \to c(t) + w(t)\, \delta, \qquad w(t_0) = 1, \qquad w(t) = 0 \text{ for } |t - t_0| \ge \text{reach},

with a C2 weight of three cubics on each side, so the result is an exact cubic spline with seven more knots. The
correction changes by the same weight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from mixseq.arrays import Float, Index
from mixseq.errors import SettingsError
from mixseq.frame_numbers import Seconds
from mixseq.operations.joining import SLACK, snapped
from mixseq.operations.sculpt import smoothstep
from mixseq.operations.sketch import cardinal_weights
from mixseq.operations.splines import between, breakpoints, sites_of
from mixseq.public import public
from mixseq.signals.curve import Curve
from mixseq.signals.mds_embedding import Plane
from mixseq.signals.model import Model

REACH = 1 / 8
"""Default reach, as a fraction of the duration."""

FRAMES = 2
"""Shortest default reach, in frames."""

SPREAD_FRAMES = 64
"""Largest number of frames that poses are interpolated from."""

STEEPEST = 2.0
"""Largest distance in pose space per distance in the plane of two of these frames, as a multiple of the mean."""

DROPPED = 1e-3
"""Distance below which a point is dropped on a frame, as a fraction of the largest distance in the plane."""

SAME_PLACE = 1e-6
"""Distance below which frames share a place, as a fraction of the largest distance in the plane."""


@public
def drag(
    model: Model, time: Seconds, to: ArrayLike, reach: Seconds | None = None, plane: Plane | None = None
) -> Model:
    """Return the model with its curve in the embedding pulled to a place.

    The pose is interpolated from frames near that place. The placement of bodies stays. The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    time : float
        Time of the pulled point, in seconds.
    to : (2,) array_like
        Target in the coordinates of `Model.embedding`, in diagonals; if the embedding is a line, the nearest point of
        it.
    reach : float, optional
        Seconds over which the change fades on both sides; by default an eighth of the motion, at least two frames.
    plane : Plane, optional
        The embedding of `to`: the `Model.plane` of a model with the same pose and shape signals; by default that of
        `model`. The result has another plane: for repeated drags in one picture give the plane of the first model.

    Returns
    -------
    Model
        ``result.embedding([time], plane)`` is `to`.

    Raises
    ------
    SettingsError
        If the time is outside the model, `to` is no place, the reach is too short, the plane is of another model, or
        the embedding is one point.
    """
    place = _place(to)
    time = snapped(model, time)
    reach = _reach(model, reach)
    plane = model.plane if plane is None else model.known(plane)
    if not plane.directions.any():
        raise SettingsError(
            "the embedding of the model is one point, as its shape does not change; there is nothing to drag"
        )
    step, correction = _changes(model, time, place, plane)
    return replace(
        model,
        time=_pulled(model.time, time, reach, step),
        correction=_pulled(model.correction, time, reach, correction),
    )


def _changes(model: Model, time: float, place: Float, plane: Plane) -> tuple[Float, Float]:
    """Return changes of time signal ``(k,)`` and correction ``(C,)`` that move the point at a time to a place."""
    move = place - model.embedding([time], plane)[0]
    axes = model.pose.matrix @ plane.axes
    times = np.append(time, model.times)
    times = times[_spread_frames(model.time(times), axes, move)]
    points = model.time(times)
    weights = cardinal_weights((points - points[0]) @ axes)(np.stack([move, np.zeros(2)]))
    change = weights[0] - weights[1]
    step, correction = change @ points, change @ model.correction(times)
    rest = np.linalg.pinv(axes.T @ plane.directions, rcond=1e-6) @ (move - step @ axes)
    return step + plane.directions @ rest, correction


def _spread_frames(points: Float, axes: Float, move: Float) -> Index:
    """Return ids of points ``(N, k)`` to interpolate: the first, one hit by a move ``(2,)``, and others far apart."""
    places = points @ axes
    places -= places[0]
    nearest = np.linalg.norm(places, axis=1)
    least = SAME_PLACE * float(nearest.max())
    found, away = [0], np.linalg.norm(places - move, axis=1)
    if away.argmin() and away.min() <= DROPPED * float(nearest.max()):
        found.append(int(away.argmin()))
        np.minimum(nearest, np.linalg.norm(places - places[found[-1]], axis=1), out=nearest)
    given = len(found)
    while len(found) <= SPREAD_FRAMES and nearest.max() > least:
        found.append(int(nearest.argmax()))
        np.minimum(nearest, np.linalg.norm(places - places[found[-1]], axis=1), out=nearest)
    apart, away = (cdist(each[found], each[found]) for each in (places, points))
    steepest = STEEPEST * np.linalg.norm(away) / (np.linalg.norm(apart) or 1.0)
    kept: list[int] = []
    for number in range(len(found)):
        if number < given or (away[number, kept] <= steepest * apart[number, kept]).all():
            kept.append(number)
    return np.array(found)[kept]


def _pulled(curve: Curve, time: float, reach: float, change: Float) -> Curve:
    """Return a curve with a change ``(k,)`` at a time, fading to zero over `reach` seconds on both sides."""
    if not change.any():
        return curve
    ends = np.array([curve.start, curve.end])
    knots = np.concatenate([breakpoints(curve), time + reach * np.linspace(-1.0, 1.0, 7)])
    sites = sites_of(ends, between(knots, *ends))
    sites[np.abs(sites - time).argmin()] = time  # which may be taken for a knot that is nearly there
    weight = smoothstep(sites, time - reach, time) * (1.0 - smoothstep(sites, time, time + reach))
    values, near = curve(sites), weight > 0
    values[near] += weight[near, None] * change
    return Curve(sites, values)


def default_reach(model: Model) -> float:
    """Return the default reach of a drag, in seconds."""
    return max(REACH * (model.end - model.start), FRAMES / model.header.fps)


def _place(to: ArrayLike) -> Float:
    place = np.asarray(to, dtype=np.float64)
    if place.shape != (2,):
        raise SettingsError(f"to has shape {place.shape}; a place in the embedding, (2,), is expected")
    if not np.isfinite(place).all():
        raise SettingsError(f"to is ({place[0]}, {place[1]}); two finite numbers are expected")
    return place


def _reach(model: Model, reach: float | None) -> float:
    if reach is None:
        return default_reach(model)
    shortest = SLACK / model.header.fps
    if not (np.isfinite(reach) and reach >= shortest):
        raise SettingsError(f"reach is {reach:g} s; a number of seconds is expected, at least {shortest:g}")
    return float(reach)
