r"""Edits in the embedding of a model: sketch a curve that becomes a new sequence, or drag a point of the time curve.

Every frame j of the model has a position :math:`y_j` in the plane (`Model.embedding`). Points :math:`c_j` of pose
space, and placements, are interpolated from there to any other position:

.. math:: c(y) = \sum_j w_j(y)\, c_j, \qquad w_j(y_i) = \delta_{ij}, \qquad \sum_j w_j(y) = 1

The weights are the cardinal functions of interpolation by a constant and radial functions,

.. math:: a + \sum_j b_j \sqrt{|y - y_j|^2 + (\varepsilon d_j)^2}, \qquad \sum_j b_j = 0,

with the distance :math:`d_j` from frame j to its nearest neighbour: multiquadrics, cones with slightly rounded tips.
Cones (:math:`\varepsilon = 0`) have almost no negative weights, but a kink at every frame. Rounder functions, such as
thin plates, are slightly more accurate where the embedding determines the motion, and overshoot badly elsewhere: where
paths cross, or frames nearly meet. As :math:`\sum b_j = 0`, weights stay bounded for distant y.

A drag pulls a point of the time curve, and the motion around it follows. Pose and correction at a position are
interpolated by the same weights, :math:`c^*(y)`, from the pulled point and from frames spread over the plane, so a
point that is pulled to one of these frames becomes that frame. Of two frames that are close in the plane and far apart
in pose space, which would make :math:`c^*` steep, one is left out.

The embedding of a model (`Model.embedding`) is affine in pose space, :math:`y(t) = A^T (c(t) - \bar c)`. Where the
interpolated pose misses the position by :math:`\Delta y`, the step of least shape change is along the two principal
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
    TIME_TOLERANCE_FRAMES,
    breakpoints,
    fade_window,
    interpolate_adaptively,
    placement_norm,
    shape_norm,
    signal_norms,
    sites_between,
    snap_time,
)
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.sequence.header import frame_times
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.types import Float, Index

TIP_RADIUS_RATIO = 0.25
"""Radius of the rounded tip of a cone, as a fraction of the distance to the nearest frame."""

MIN_SPACING_RATIO = 1e-6
"""Distance at which two frames share a position, as a fraction of the embedding's size."""

MAX_DISTANCE_RATIO = 0.5
"""Largest distance of a curve from all frames without a warning, as a fraction of the embedding's size."""

SIGNAL_TOLERANCE = 1e-4
"""Largest error of signals between sites, in diagonals."""


@public
def sketch(model: Model, curve: ArrayLike, duration: Seconds, plane: Plane | None = None) -> Model:
    """Make a motion from a curve in the embedding of a model.

    The motion starts at 0 s and runs along the curve at constant speed. Where the curve passes through the position of
    a frame, it shows this frame. The residual layer is left out.

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
        In the same space, with the same pose and shape signals. The first of several frames of one position represents
        them.

    Raises
    ------
    SettingsError
        If the curve is invalid, the duration is not positive, or the plane is of other key shapes.

    Warns
    -----
    MixseqWarning
        If different frames share a position, or the curve runs far from all frames, where shapes are extrapolated.
    """
    if not (np.isfinite(duration) and duration > 0):
        raise SettingsError(f"duration is {duration}; a positive number of seconds is expected")
    header = model.header.with_times(frame_times(0.0, float(duration), model.header.fps))
    path = _curve_through(curve, float(duration))
    positions = model.embedding(model.times, plane)
    frames = _distinct_frames(model, positions)
    times, positions = model.times[frames], positions[frames]
    _warn_if_far(path, positions)
    weights = cardinal_weights(positions)

    def blend(values: Float) -> Callable[[Float], Float]:
        return lambda sample_times: weights(path(sample_times)) @ values

    time, placement, correction = (
        interpolate_adaptively(blend(curve(times)), path.times, SIGNAL_TOLERANCE, norm)
        for curve, norm in zip(model.curves, signal_norms(model), strict=True)
    )
    return model.with_motion(time, placement, correction, header)


def cardinal_weights(positions: Float) -> Callable[[Float], Float]:
    """Return the cardinal functions of positions ``(M, 2)``: a map from points ``(N, 2)`` to weights ``(N, M)``."""
    count = len(positions)
    if count == 1:
        return lambda points: np.ones((len(points), 1))
    distances = cdist(positions, positions)
    nearest = (distances + np.diag(np.full(count, np.inf))).min(axis=1)
    unit = float(nearest.mean())  # for the system to be well scaled

    def basis(distances: Float) -> Float:
        radial = np.hypot(distances, TIP_RADIUS_RATIO * nearest) / unit
        return np.concatenate([radial, np.ones((len(distances), 1))], axis=1)

    system = np.ones((count + 1, count + 1))
    system[:count] = basis(distances)
    system[count, count] = 0.0
    inverse = np.linalg.inv(system)[:, :count]

    def weights(points: Float) -> Float:
        raw = basis(cdist(points, positions)) @ inverse
        return np.asarray(raw + (1.0 - raw.sum(axis=1, keepdims=True)) / count)  # rounding, far away

    return weights


def _curve_through(curve: ArrayLike, duration: float) -> Curve:
    """Interpolate the points of a curve by a spline, parametrised by chord length."""
    points = np.asarray(curve, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise SettingsError(f"the drawn curve has shape {points.shape}; (N, 2) is expected, with N > 0")
    if not np.isfinite(points).all():
        number = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise SettingsError(f"point {number} of the drawn curve is not finite")
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    moves_mask = chords > 1e-9 * chords.sum()  # repeated points are merged
    points = points[np.append(True, moves_mask)]
    if len(points) == 1:
        return Curve(np.array([0.0, duration]), np.repeat(points, 2, axis=0))
    lengths = np.append(0.0, np.cumsum(chords[moves_mask]))
    times = duration * (lengths / lengths[-1])
    return Curve(times, points)


def _distinct_frames(model: Model, positions: Float) -> Index:
    """Return the frames with distinct positions ``(T, 2)``: the first of those that share one."""
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    is_close = cdist(positions, positions) <= MIN_SPACING_RATIO * size
    distinct: list[int] = []
    representatives = np.empty(len(positions), dtype=np.int64)
    for frame, close_mask in enumerate(is_close):
        first = next((earlier for earlier in distinct if close_mask[earlier]), None)
        representatives[frame] = frame if first is None else first
        if first is None:
            distinct.append(frame)
    hidden_mask = _frame_distances(model, representatives) > SIGNAL_TOLERANCE
    if hidden_mask.any():
        warnings.warn(
            f"{np.count_nonzero(hidden_mask)} frames share their position in the embedding with an earlier frame that "
            "differs; a sketch shows the earlier one",
            MixseqWarning,
            stacklevel=4,
        )
    return np.array(distinct, dtype=np.int64)


def _frame_distances(model: Model, others: Index) -> Float:
    """Return distances ``(T,)`` of frames to other frames in shape and placement, in diagonals."""
    points, placements = model.time(model.times), model.placement(model.times)
    shape_distances = shape_norm(model)(points - points[others])
    return np.maximum(shape_distances, placement_norm(model)(placements - placements[others]))


def _warn_if_far(path: Curve, positions: Float) -> None:
    """Warn if a curve runs far from all frames at positions ``(M, 2)``."""
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    distances = cdist(path.values, positions).min(axis=1)
    if len(positions) > 1 and distances.max() > MAX_DISTANCE_RATIO * size:
        point = path.values[distances.argmax()]
        warnings.warn(
            f"the drawn curve goes to ({point[0]:.3g}, {point[1]:.3g}), far from all frames, which are within "
            f"{size:.3g} of each other; shapes there are guesses",
            MixseqWarning,
            stacklevel=4,
        )


DEFAULT_REACH_RATIO = 1 / 8
"""Default reach of a drag, as a fraction of the duration."""

MIN_REACH_FRAMES = 2
"""Shortest default reach, in frames."""

MAX_DRAG_FRAMES = 64
"""Largest number of frames from which a dragged pose is interpolated."""

MAX_SLOPE_RATIO = 2.0
"""Largest distance in pose space per distance in the plane of two of these frames, as a multiple of the mean."""

DROP_DISTANCE_RATIO = 1e-3
"""Distance within which a point is dropped on a frame, as a fraction of the largest distance in the plane."""


@public
def drag(model: Model, time: Seconds, to: ArrayLike, reach: Seconds | None = None, plane: Plane | None = None) -> Model:
    """Drag a point of the time curve in the embedding of a model.

    The pose is interpolated from frames near the target. The placement of bodies stays. The residual layer is kept.

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
        If the time is outside the model, `to` is not a point of the plane, the reach is too short, the plane is of
        another model, or the embedding is one point.
    """
    target = _check_target(to)
    time = snap_time(model, time)
    reach = _check_reach(model, reach)
    plane = model.plane if plane is None else model.check_plane(plane)
    if not plane.directions.any():
        raise SettingsError(
            "the embedding of the model is one point, as its shape does not change; there is nothing to drag"
        )
    step, correction = _drag_changes(model, time, target, plane)
    return replace(
        model,
        time=_add_fading_change(model.time, time, reach, step),
        correction=_add_fading_change(model.correction, time, reach, correction),
    )


def _drag_changes(model: Model, time: float, target: Float, plane: Plane) -> tuple[Float, Float]:
    """Return changes of time signal ``(k,)`` and correction ``(C,)`` that move the point at a time to a target."""
    move = target - model.embedding([time], plane)[0]
    axes = model.pose.matrix @ plane.axes
    times = np.append(time, model.times)
    times = times[_select_drag_points(model.time(times), axes, move)]
    points = model.time(times)
    weights = cardinal_weights((points - points[0]) @ axes)(np.stack([move, np.zeros(2)]))
    change = weights[0] - weights[1]
    step, correction = change @ points, change @ model.correction(times)
    remainder = np.linalg.pinv(axes.T @ plane.directions, rcond=1e-6) @ (move - step @ axes)
    return step + plane.directions @ remainder, correction


def _select_drag_points(points: Float, axes: Float, move: Float) -> Index:
    """Return ids of points ``(N, k)`` to interpolate: the first, one hit by a move ``(2,)``, and others far apart."""
    positions = points @ axes
    positions -= positions[0]
    nearest = np.linalg.norm(positions, axis=1)  # distance to the nearest selected point
    min_distance = MIN_SPACING_RATIO * float(nearest.max())
    ids, target_distances = [0], np.linalg.norm(positions - move, axis=1)
    if target_distances.argmin() and target_distances.min() <= DROP_DISTANCE_RATIO * float(nearest.max()):
        ids.append(int(target_distances.argmin()))
        np.minimum(nearest, np.linalg.norm(positions - positions[ids[-1]], axis=1), out=nearest)
    required_count = len(ids)
    while len(ids) <= MAX_DRAG_FRAMES and nearest.max() > min_distance:
        ids.append(int(nearest.argmax()))
        np.minimum(nearest, np.linalg.norm(positions - positions[ids[-1]], axis=1), out=nearest)
    in_plane, in_pose_space = (cdist(values[ids], values[ids]) for values in (positions, points))
    max_slope = MAX_SLOPE_RATIO * np.linalg.norm(in_pose_space) / (np.linalg.norm(in_plane) or 1.0)
    kept: list[int] = []
    for index in range(len(ids)):
        if index < required_count or (in_pose_space[index, kept] <= max_slope * in_plane[index, kept]).all():
            kept.append(index)
    return np.array(ids)[kept]


def _add_fading_change(curve: Curve, time: float, reach: float, change: Float) -> Curve:
    """Add a change ``(k,)`` to a curve at a time, fading to zero over `reach` seconds on both sides."""
    if not change.any():
        return curve
    knots = np.concatenate([breakpoints(curve), time + reach * np.linspace(-1.0, 1.0, 7)])
    sites = sites_between(curve.start, curve.end, knots)
    sites[np.abs(sites - time).argmin()] = time  # in case it was merged with a knot
    weight = fade_window(sites, (time - reach, time), (time, time + reach))
    values, changed_mask = curve(sites), weight > 0
    values[changed_mask] += weight[changed_mask, None] * change
    return Curve(sites, values)


def default_reach(model: Model) -> float:
    """Return the default reach of a drag, in seconds."""
    return max(DEFAULT_REACH_RATIO * (model.end - model.start), MIN_REACH_FRAMES / model.header.fps)


def _check_target(to: ArrayLike) -> Float:
    target = np.asarray(to, dtype=np.float64)
    if target.shape != (2,):
        raise SettingsError(f"to has shape {target.shape}; a point of the embedding, (2,), is expected")
    if not np.isfinite(target).all():
        raise SettingsError(f"to is ({target[0]}, {target[1]}); two finite numbers are expected")
    return target


def _check_reach(model: Model, reach: float | None) -> float:
    if reach is None:
        return default_reach(model)
    min_reach = TIME_TOLERANCE_FRAMES / model.header.fps
    if not (np.isfinite(reach) and reach >= min_reach):
        raise SettingsError(f"reach is {reach:g} s; a number of seconds is expected, at least {min_reach:g}")
    return float(reach)
