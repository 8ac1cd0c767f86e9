r"""Edits in the embedding of a model: sketch a curve that becomes a new sequence, or drag a point of the time curve.

Every frame j of the model has a place :math:`y_j` in the plane (`Model.embedding`). Points :math:`c_j` of pose space,
and placements, are interpolated from there to any other place of the plane:

.. math:: c(y) = \sum_j w_j(y)\, c_j, \qquad w_j(y_i) = \delta_{ij}, \qquad \sum_j w_j(y) = 1

The weights are the cardinal functions of interpolation by a constant and radial functions,

.. math:: a + \sum_j b_j \sqrt{|y - y_j|^2 + (\varepsilon d_j)^2}, \qquad \sum_j b_j = 0,

with the distance :math:`d_j` from frame j to its nearest neighbour: multiquadrics, cones with slightly rounded tips.
Cones (:math:`\varepsilon = 0`) have almost no negative weights, but a kink at every frame. Rounder functions, such as
thin plates, are slightly more accurate where the embedding determines the motion, and overshoot badly elsewhere: where
paths cross, or frames nearly meet. As :math:`\sum b_j = 0`, weights stay bounded for distant y.

A drag pulls a point of the time curve, and the motion around it follows. Pose and correction at a place are
interpolated by the same weights, :math:`c^*(y)`, from the pulled point and from frames spread over the plane, so a
point that is pulled to one of these frames becomes that frame. Of two frames that are close in the plane and far apart
in pose space, which would make :math:`c^*` steep, one is left out.

The embedding of a model (`Model.embedding`) is affine in pose space, :math:`y(t) = A^T (c(t) - \bar c)`. Where the
interpolated pose misses the place by :math:`\Delta y`, the step of least shape change is along the two principal
directions P of the plane (`mixseq.signals.pose`),

.. math:: \delta = c^*(y) - c^*(y(t_0)) + P\, (A^T P)^+ \Delta y .

The change fades out on both sides,

.. math:: c(t) \to c(t) + w(t)\, \delta, \qquad w(t_0) = 1, \qquad w(t) = 0 \text{ for } |t - t_0| \ge \text{reach},

with a C2 weight of three cubics on each side, so the result is an exact cubic spline with seven more knots. The
correction changes by the same weight.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.operations.sections import (
    SLACK,
    breakpoints,
    measures_of,
    placement_measure,
    sampled,
    shape_measure,
    sites_between,
    snapped,
    window,
)
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.sequence.header import frame_times
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.types import Float, Index

ROUNDING = 0.25
"""Radius of a rounded tip, as a fraction of the distance to the nearest frame."""

SAME_PLACE = 1e-6
"""Largest distance of frames of one place, as a fraction of the embedding's size."""

FAR = 0.5
"""Distance beyond which a curve is far from all frames, as a fraction of the embedding's size."""

ACCURACY = 1e-4
"""Largest error, in diagonals, of the splines between sites."""


@public
def sketch(model: Model, curve: ArrayLike, duration: Seconds, plane: Plane | None = None) -> Model:
    """Return the motion along a curve in the embedding of a model.

    The motion starts at 0 s and runs along the curve at constant speed. Where the curve passes through the place of a
    frame, it shows this frame. The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion whose shapes are interpolated. The more of it the embedding represents, the more can be drawn.
    curve : (N, 2) array_like
        Points in the coordinates of `Model.embedding`, in diagonals, joined by a spline. One point is a held pose.
    duration : float
        Duration in seconds, at the frame rate of the model.
    plane : Plane, optional
        The embedding of the curve: the `Model.plane` of a model with the same pose and shape signals; by default that
        of `model`.

    Returns
    -------
    Model
        In the same space, with the same pose and shape signals. The first of several frames of one place represents
        them.

    Raises
    ------
    SettingsError
        If the curve is none, the duration is not positive, or the plane is of other key shapes.

    Warns
    -----
    MixseqWarning
        If different frames share a place, or the curve runs far from all frames, where shapes are extrapolated.
    """
    if not (np.isfinite(duration) and duration > 0):
        raise SettingsError(f"duration is {duration}; a positive number of seconds is expected")
    header = model.header.with_times(frame_times(0.0, float(duration), model.header.fps))
    drawn = _drawn(curve, float(duration))
    places = model.embedding(model.times, plane)
    frames = _frames_apart(model, places)
    times, places = model.times[frames], places[frames]
    _warn_if_far(drawn, places)
    weights = cardinal_weights(places)

    def blended(values: Float) -> Callable[[Float], Float]:
        return lambda at: weights(drawn(at)) @ values

    time, placement, correction = (
        sampled(blended(curve(times)), drawn.times, ACCURACY, measure)
        for curve, measure in zip(model.curves, measures_of(model), strict=True)
    )
    return model.with_motion(time, placement, correction, header)


def cardinal_weights(places: Float) -> Callable[[Float], Float]:
    """Return the cardinal functions of places ``(M, 2)``: a function from points ``(N, 2)`` to weights ``(N, M)``."""
    count = len(places)
    if count == 1:
        return lambda points: np.ones((len(points), 1))
    apart = cdist(places, places)
    nearest = (apart + np.diag(np.full(count, np.inf))).min(axis=1)
    unit = float(nearest.mean())  # for the system to be well scaled

    def functions(distances: Float) -> Float:
        radial = np.hypot(distances, ROUNDING * nearest) / unit
        return np.concatenate([radial, np.ones((len(distances), 1))], axis=1)

    system = np.ones((count + 1, count + 1))
    system[:count] = functions(apart)
    system[count, count] = 0.0
    inverse = np.linalg.inv(system)[:, :count]

    def weights(points: Float) -> Float:
        raw = functions(cdist(points, places)) @ inverse
        return np.asarray(raw + (1.0 - raw.sum(axis=1, keepdims=True)) / count)  # rounding, far away

    return weights


def _drawn(curve: ArrayLike, duration: float) -> Curve:
    """Return the spline through the points of a curve, parametrised by chord length."""
    points = np.asarray(curve, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise SettingsError(
            f"the drawn curve has shape {points.shape}; (N, 2) is expected, one point at least"
        )
    if not np.isfinite(points).all():
        number = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise SettingsError(f"point {number} of the drawn curve is not finite")
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    moves = chords > 1e-9 * chords.sum()  # the same point twice is one point
    points = points[np.append(True, moves)]
    if len(points) == 1:
        return Curve(np.array([0.0, duration]), np.repeat(points, 2, axis=0))
    along = np.append(0.0, np.cumsum(chords[moves]))
    times = duration * (along / along[-1])
    return Curve(times, points)


def _frames_apart(model: Model, places: Float) -> Index:
    """Return the frames with distinct places ``(T, 2)``: the first of those that share one."""
    size = float(np.linalg.norm(np.ptp(places, axis=0)))
    close = cdist(places, places) <= SAME_PLACE * size
    chosen: list[int] = []
    stands_for = np.empty(len(places), dtype=np.int64)
    for frame, near in enumerate(close):
        first = next((earlier for earlier in chosen if near[earlier]), None)
        stands_for[frame] = frame if first is None else first
        if first is None:
            chosen.append(frame)
    hidden = _apart(model, stands_for) > ACCURACY
    if hidden.any():
        warnings.warn(
            f"{np.count_nonzero(hidden)} frames share their place in the embedding with an earlier frame that differs; "
            "a sketch shows the earlier one",
            MixseqWarning,
            stacklevel=4,
        )
    return np.array(chosen, dtype=np.int64)


def _apart(model: Model, others: Index) -> Float:
    """Return distances ``(T,)`` of frames to other frames in shape and placement, in diagonals."""
    points, places = model.time(model.times), model.placement(model.times)
    shapes = shape_measure(model)(points - points[others])
    return np.maximum(shapes, placement_measure(model)(places - places[others]))


def _warn_if_far(drawn: Curve, places: Float) -> None:
    size = float(np.linalg.norm(np.ptp(places, axis=0)))
    away = cdist(drawn.values, places).min(axis=1)
    if len(places) > 1 and away.max() > FAR * size:
        point = drawn.values[away.argmax()]
        warnings.warn(
            f"the drawn curve goes to ({point[0]:.3g}, {point[1]:.3g}), far from all frames, which are within "
            f"{size:.3g} of each other; shapes there are guesses",
            MixseqWarning,
            stacklevel=4,
        )


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
    plane = model.plane if plane is None else model.check_plane(plane)
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
    knots = np.concatenate([breakpoints(curve), time + reach * np.linspace(-1.0, 1.0, 7)])
    sites = sites_between(curve.start, curve.end, knots)
    sites[np.abs(sites - time).argmin()] = time  # which may be taken for a knot that is nearly there
    weight = window(sites, (time - reach, time), (time, time + reach))
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
