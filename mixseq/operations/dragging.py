r"""Drag: a place on the curve that a motion is in the plane is moved, and the motion next to it follows.

Frames of the model say what pose belongs to a place: :math:`c^*(y)` interpolates the pulled point and frames that are
spread over the plane, as a sketch does (`mixseq.operations.sketch`), so a point that is pulled to a frame becomes that
frame. The embedding of a model (`Model.embedding`) is affine in pose space, :math:`y(t) = A^T (c(t) - \bar c)`. Where
the interpolated pose misses the place by :math:`\Delta y`, the change that changes the shape least is along the two
principal directions P of the plane (`mixseq.signals.mds_embedding`),

.. math:: \delta = c^*(y) - c(t_0) + P\, (A^T P)^+ \Delta y .

The change fades out on both sides,

.. math:: c(t) \to c(t) + w(t)\, \delta, \qquad w(t_0) = 1, \qquad w(t) = 0 \text{ for } |t - t_0| \ge \text{reach},

with a weight of three cubics on each side, two times continuously differentiable. So the result is a cubic spline
again: exactly, with seven knots more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.frame_numbers import Seconds
from mixseq.operations.joining import SLACK, snapped
from mixseq.operations.sculpt import smoothstep
from mixseq.operations.sketch import cardinal_weights, farthest_points
from mixseq.operations.splines import between, breakpoints, sites_of
from mixseq.public import public
from mixseq.signals.curve import Curve
from mixseq.signals.mds_embedding import Plane
from mixseq.signals.model import Model

REACH = 1 / 8
"""Default reach, as a fraction of the motion. Ours."""

FRAMES = 2
"""Shortest default reach, in frames. Ours."""

SPREAD_FRAMES = 64
"""Frames, spread over the plane, that say what poses belong to places."""


@public
def drag(
    model: Model, time: Seconds, to: ArrayLike, reach: Seconds | None = None, plane: Plane | None = None
) -> Model:
    """Return the model with its curve in the embedding pulled to a place.

    The pose becomes the one that frames near that place have; where bodies are does not change. The residual layer
    is kept.

    Parameters
    ----------
    model : Model
        The motion.
    time : float
        Time of the point that is pulled, in seconds.
    to : (2,) array_like
        Where to, in the coordinates of `Model.embedding`, in diagonals. If the embedding is a line, the point goes as
        near as it can.
    reach : float, optional
        Over how many seconds the change fades on both sides; by default an eighth of the motion, at least two frames.
    plane : Plane, optional
        The embedding that is meant, the `Model.plane` of a model with the same pose and shape signals; by default that
        of `model`. The result has another one of its own: give the plane of the first model if you drag again and again
        and look at one picture.

    Returns
    -------
    Model
        ``result.embedding([time], plane)`` is `to`, with the plane that was meant.

    Raises
    ------
    SettingsError
        If the time is outside the model, `to` is no place, the reach is too short, the plane is of another model, or
        the embedding is one point: the shape does not change, so there is nowhere to go.
    """
    place = _place(to)
    time = snapped(model, time)
    reach = _reach(model, reach)
    plane = model.plane if plane is None else model.known(plane)
    if not plane.directions.any():
        raise SettingsError(
            "the embedding of the model is one point, as its shape does not change; there is nothing to drag"
        )
    change = _change(model, time, place, plane)

    ends = np.array([model.time.start, model.time.end])
    knots = np.concatenate([breakpoints(model.time), time + reach * np.linspace(-1.0, 1.0, 7)])
    sites = sites_of(ends, between(knots, *ends))
    sites[np.abs(sites - time).argmin()] = time  # which may be taken for a knot that is nearly there
    weight = smoothstep(sites, time - reach, time) * (1.0 - smoothstep(sites, time, time + reach))
    return replace(
        model,
        time=Curve(sites, model.time(sites) + weight[:, None] * change),
        correction=_faded(model, time, reach),
    )


def _change(model: Model, time: float, place: Float, plane: Plane) -> Float:
    """Return the change in pose space ``(k,)`` of the point at a time that is pulled to a place ``(2,)``."""
    here = model.embedding([time], plane)
    frames = model.times[farthest_points(model.embedding(model.times, plane), here[0], SPREAD_FRAMES)]
    places = np.concatenate([here, model.embedding(frames, plane)])
    points = np.concatenate([model.time([time]), model.time(frames)])
    change = (cardinal_weights(places)(place[None]) @ points)[0] - points[0]
    along = (model.pose.rates(plane.directions.T) @ plane.axes).T  # A^T P: 1, but for rounding and for lines
    there = here[0] + model.pose.rates(change[None])[0] @ plane.axes
    return np.asarray(change + plane.directions @ np.linalg.pinv(along, rcond=1e-6) @ (place - there))


def _faded(model: Model, time: float, reach: float) -> Curve:
    """Return the correction without what it is at the time: it belongs to the pose that was there."""
    if not model.correction.values.any():
        return model.correction
    ends = np.array([model.correction.start, model.correction.end])
    knots = np.concatenate([model.correction.times, time + reach * np.linspace(-1.0, 1.0, 7)])
    sites = sites_of(ends, between(knots, *ends))
    weight = smoothstep(sites, time - reach, time) * (1.0 - smoothstep(sites, time, time + reach))
    return Curve(sites, (1.0 - weight[:, None]) * model.correction(sites))


def default_reach(model: Model) -> float:
    """Return over how many seconds the change of a drag fades on both sides, if nothing else is asked for."""
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
