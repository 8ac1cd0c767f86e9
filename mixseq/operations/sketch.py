r"""Edit a model in its embedding: sketch a curve to make a new sequence, or drag a point of the time curve.

Every frame j of the model has a position :math:`y_j` in the plane (`Model.embedding`). Its point :math:`c_j` of pose
space, and its placement, are interpolated to other positions y:

.. math:: c(y) = \sum_j w_j(y)\, c_j, \qquad w_j(y_i) = \delta_{ij}, \qquad \sum_j w_j(y) = 1

The weights are the cardinal functions of interpolation by a constant and radial functions,

.. math:: a + \sum_j b_j \sqrt{|y - y_j|^2 + (\varepsilon d_j)^2}, \qquad \sum_j b_j = 0,

with the distance :math:`d_j` from frame j to its nearest neighbour. These multiquadrics are cones with rounded tips,
which have few negative weights. As :math:`\sum b_j = 0`, weights stay bounded for distant y.

A drag moves a point of the time curve, and the motion around it follows. Pose and correction at a position,
:math:`c^*(y)`, are interpolated by the same weights from the dragged point and from frames spread over the plane. A
point that is dragged to one of these frames becomes this frame. Two frames that are close in the plane and far apart in
pose space would make :math:`c^*` steep, so one of the two is omitted.

The embedding of a model (`Model.embedding`) is affine in pose space, :math:`y(t) = A^T (c(t) - \bar c)`. Where the
interpolated pose misses the position by :math:`\Delta y`, the step of least shape change is along the two principal
directions P of the plane (`mixseq.signals.pose`),

.. math:: \delta = c^*(y) - c^*(y(t_0)) + P\, (A^T P)^+ \Delta y .

The change fades out before and after the time :math:`t_0`,

.. math:: c(t) \to c(t) + w(t)\, \delta, \qquad w(t_0) = 1, \qquad w(t) = 0 \text{ for } |t - t_0| \ge \text{reach},

with a C2 weight of three cubics before and three after, so the result is an exact cubic spline with seven more knots.
The change of the correction has the same weight.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.operations.sections import (
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
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, Seconds
from mixseq.sequence.header import frame_times
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.types import Float, Index

TIP_RADIUS_RATIO = 0.25  # radius of the rounded tip of a cone, as a fraction of the distance to the nearest frame
MIN_SPACING_RATIO = 1e-6  # distance up to which two frames count as one position, as a fraction of the embedding's size
MAX_DISTANCE_RATIO = 0.5  # distance from the nearest frame that is warned of, as a fraction of the embedding's size
SIGNAL_TOLERANCE = 1e-4  # largest error of signals between sites, in diagonals


@public
def sketch(model: Model, curve: ArrayLike, duration: Seconds, plane: Plane | None = None) -> Model:
    """Make a motion from a curve in the embedding of a model.

    The motion starts at 0 s and runs along the curve at constant speed. Where the curve passes through the position of
    a frame, the motion shows this frame.

    Parameters
    ----------
    model : Model
        The motion whose shapes are interpolated.
    curve : (N, 2) array_like
        Points in the coordinates of `Model.embedding`, in diagonals, joined by a spline. A single point holds a pose.
    duration : float
        Duration in seconds. The frame rate is the rate of the model.
    plane : Plane, optional
        The embedding that contains the curve: `Model.plane` of any model with the same pose and shape signals; by
        default of `model`.

    Returns
    -------
    Model
        Model in the same space, with the same pose and shape signals. If several frames share a position, the first
        frame is used.

    Raises
    ------
    SettingsError
        If the curve is invalid, the duration is not positive, or the plane belongs to other key shapes.

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
    return model.edited(header=header, time=time, placement=placement, correction=correction)


def cardinal_weights(positions: Float) -> Callable[[Float], Float]:
    """Return the cardinal functions of positions ``(M, 2)``: a map from points ``(N, 2)`` to weights ``(N, M)``."""
    count = len(positions)
    if count == 1:
        return lambda points: np.ones((len(points), 1))
    distances = cdist(positions, positions)
    nearest = (distances + np.diag(np.full(count, np.inf))).min(axis=1)
    unit = float(nearest.mean())  # unit of length, so that the system is well scaled

    def basis(distances: Float) -> Float:
        radial = np.hypot(distances, TIP_RADIUS_RATIO * nearest) / unit
        return np.concatenate([radial, np.ones((len(distances), 1))], axis=1)

    system = np.ones((count + 1, count + 1))
    system[:count] = basis(distances)
    system[count, count] = 0.0
    inverse = np.linalg.inv(system)[:, :count]

    def weights(points: Float) -> Float:
        raw = basis(cdist(points, positions)) @ inverse
        return np.asarray(raw + (1.0 - raw.sum(axis=1, keepdims=True)) / count)  # against rounding errors far away

    return weights


def _curve_through(curve: ArrayLike, duration: float) -> Curve:
    """Return a spline through the points of a curve, parametrised by chord length."""
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
    """Return the frames with distinct positions ``(T, 2)``: the first frame at each position."""
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    is_close = cdist(positions, positions) <= MIN_SPACING_RATIO * size
    distinct: list[int] = []
    representatives = np.empty(len(positions), dtype=np.int64)
    for frame, close_mask in enumerate(is_close):
        first = next((earlier for earlier in distinct if close_mask[earlier]), None)
        representatives[frame] = frame if first is None else first
        if first is None:
            distinct.append(frame)
    points, placements = model.time(model.times), model.placement(model.times)
    placement_distances = placement_norm(model)(placements - placements[representatives])
    distances = np.maximum(shape_norm(model)(points - points[representatives]), placement_distances)
    hidden_mask = distances > SIGNAL_TOLERANCE
    if hidden_mask.any():
        warnings.warn(
            f"{np.count_nonzero(hidden_mask)} frames share their position in the embedding with an earlier frame that "
            "differs; a sketch shows the earlier one",
            MixseqWarning,
            stacklevel=4,
        )
    return np.array(distinct, dtype=np.int64)


def _warn_if_far(path: Curve, positions: Float) -> None:
    """Warn if a curve passes points far from all frame positions ``(M, 2)``."""
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


DEFAULT_REACH_RATIO = 1 / 8  # default reach of a drag, as a fraction of the duration
MIN_REACH_FRAMES = 2  # shortest default reach, in frames
MAX_DRAG_FRAMES = 64  # largest number of frames used to interpolate a dragged pose
MAX_SLOPE_RATIO = 2.0  # largest ratio of distances in pose space and in the plane, as a multiple of the mean
DROP_DISTANCE_RATIO = 1e-3  # distance within which a point snaps to a frame, as a fraction of the largest


@public
def drag(model: Model, time: Seconds, to: ArrayLike, reach: Seconds | None = None, plane: Plane | None = None) -> Model:
    """Drag a point of the time curve in the embedding of a model.

    The pose is interpolated from other frames. The placement of bodies does not change.

    Parameters
    ----------
    model : Model
        The motion.
    time : float
        Time of the dragged point, in seconds.
    to : (2,) array_like
        Target in the coordinates of `Model.embedding`, in diagonals. If the embedding is a line, the nearest point of
        the line is used.
    reach : float, optional
        Seconds before and after `time` in which the change fades out; by default 1/8 of the motion, at least 2 frames.
    plane : Plane, optional
        The embedding that contains `to`: `Model.plane` of any model with the same pose and shape signals; by default of
        `model`. For repeated drags in one picture give the plane of the first model, as each result has its own plane.

    Returns
    -------
    Model
        Edited model; its point ``result.embedding([time], plane)`` is `to`.

    Raises
    ------
    SettingsError
        If the time is outside the model, `to` is not a point of the plane, the reach is too short, the plane belongs to
        another model, or the embedding is a single point.
    """
    target = _check_target(to)
    time = snap_time(model, time)
    reach = check_reach(model, reach)
    plane = model.plane if plane is None else model.check_plane(plane)
    if not plane.directions.any():
        raise SettingsError(
            "the embedding of the model is one point, as its shape does not change; there is nothing to drag"
        )
    step, correction = _drag_changes(model, time, target, plane)
    return model.edited(
        time=_add_fading_change(model.time, time, reach, step),
        correction=_add_fading_change(model.correction, time, reach, correction),
    )


def _drag_changes(model: Model, time: float, target: Float, plane: Plane) -> tuple[Float, Float]:
    """Return changes of time signal ``(k,)`` and correction ``(C,)`` that move the point at a time to the target."""
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
    """Select ids of points ``(N, k)`` to interpolate: the first, a point hit by `move` ``(2,)``, and distant points."""
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
    sites[np.abs(sites - time).argmin()] = time  # restores the exact time if it was merged with a knot
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


def check_reach(model: Model, reach: float | None, name: str = "reach") -> float:
    """Validate a reach in seconds and return it; see `default_reach` for None."""
    if reach is None:
        return default_reach(model)
    min_reach = FRAME_TOLERANCE / model.header.fps
    if not (np.isfinite(reach) and reach >= min_reach):
        raise SettingsError(f"{name} is {reach:g} s; a number of seconds is expected, at least {min_reach:g}")
    return float(reach)
