r"""Sculpt: an edit of one frame by hand, applied over time.

The difference :math:`\Delta` of the mesh at a time and the edited mesh in the shape space
(`ShapeSpace.shape_difference`) is independent of the placement of parts, so it can be added to any frame:

.. math:: s(t) = \sum_j \varphi_j(c(t))\, P_j + w(t)\, \Delta

The model gets a key shape, :math:`P_0 + \Delta`, and pose space a coordinate, w. It is 1 at the edited time, and
elsewhere

everywhere
    1;
window
    zero outside of a window, with a C2 rise and fall;
similar
    :math:`\exp(-(d / r)^2 / 2)`, with the distance d in the shape space between the shape at t and the shape before
    the edit. The radius r is given as a fraction of the largest distance of the model.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.frame_numbers import Seconds
from mixseq.operations.hand_edits import edited_difference
from mixseq.operations.joining import snapped
from mixseq.operations.splines import breakpoints, refined, sampled, shape_measure, sites_of
from mixseq.public import public
from mixseq.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap

Where = Literal["everywhere", "window", "similar"]
WHERE: tuple[Where, ...] = ("everywhere", "window", "similar")

RADIUS = 0.25
"""Default radius of similarity, as a fraction of the distance to the least similar shape."""

ACCURACY = 1e-3
"""Largest error of the sampled weight between sites."""


@public
def sculpt(
    model: Model,
    time: Seconds,
    points: ArrayLike | MeshSequence,
    where: Where = "everywhere",
    start: Seconds | None = None,
    end: Seconds | None = None,
    radius: float | None = None,
) -> Model:
    """Return the model with a change that was made by hand in one frame.

    The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    time : float
        Time of the frame in seconds; also between frames.
    points : (V, 3) array_like or MeshSequence of one frame
        The edited mesh, in the file's units: ``model(time)`` with vertices moved, in the same order.
    where : {"everywhere", "window", "similar"}
        Weight of the change over time, see the module.
    start, end : float, optional
        The window, in seconds; by default open to the start, or to the end of the model.
    radius : float, optional
        Similarity: the fraction of the distance to the least similar shape at which the weight is 0.61; by default
        0.25.

    Raises
    ------
    InvalidSequenceError
        If the points are not those of the mesh, or not finite.
    SettingsError
        If a time is outside the model or the window, or settings contradict each other.
    """
    _check(where, start, end, radius)
    time = snapped(model, time)
    model, difference = edited_difference(model, time, points)
    if where == "window":
        return _added(model, difference, _window(model, time, start, end))
    if where == "similar":
        return _added(model, difference, _similar(model, time, RADIUS if radius is None else radius))
    return _added(model, difference, Curve(model.time.times, np.ones((len(model.time.times), 1))))


def _check(where: Where, start: float | None, end: float | None, radius: float | None) -> None:
    if where not in WHERE:
        raise SettingsError(f"where is {where!r}; {', '.join(map(repr, WHERE))} is expected")
    if where == "window" and start is None and end is None:
        raise SettingsError("a window needs a start or an end; give one, or where='everywhere'")
    if where != "window" and not (start is None and end is None):
        raise SettingsError(f"start and end are of a window; leave them out, or where={where!r}")
    if where != "similar" and radius is not None:
        raise SettingsError(f"radius tells what is similar; leave it out, or where={where!r}")
    if radius is not None and not (np.isfinite(radius) and radius > 0):
        raise SettingsError(f"radius is {radius}; a positive fraction of the largest distance is expected")


def _added(model: Model, difference: Float, weight: Curve) -> Model:
    """Add a difference ``(S,)`` with a weight over time, whose sites include those of the time signal."""
    row = np.zeros((1, len(model.shapes) + 1))
    row[0, 0], row[0, -1] = -1.0, 1.0
    sites = weight.times
    return replace(
        model,
        time=Curve(sites, np.concatenate([model.time(sites), weight.values], axis=1)),
        pose=PoseMap(
            np.append(model.pose.offset, 0.0),
            np.concatenate([np.pad(model.pose.matrix, ((0, 0), (0, 1))), row]),
        ),
        shapes=np.concatenate([model.shapes, model.shapes[:1] + difference]),
    )


# Weights --------------------------------------------------------------------------------------------------


def _window(model: Model, time: float, start: float | None, end: float | None) -> Curve:
    """Return the weight of a window as an exact cubic spline."""
    first = None if start is None else snapped(model, start, "start")
    last = None if end is None else snapped(model, end, "end")
    if (first is not None and not first < time) or (last is not None and not time < last):
        given = " and ".join(
            f"{name} {value:g} s" for name, value in (("start", start), ("end", end)) if value is not None
        )
        raise SettingsError(f"the window has {given}; the sculpted time, {time:g} s, must be within")
    knots = [breakpoints(model.time)]
    knots += [np.linspace(first, time, 4)] if first is not None else []
    knots += [np.linspace(time, last, 4)] if last is not None else []
    sites = _sites(model, np.concatenate(knots))
    weight = np.ones(len(sites))
    if first is not None:
        weight = weight * smoothstep(sites, first, time)
    if last is not None:
        weight = weight * (1.0 - smoothstep(sites, time, last))
    return Curve(sites, weight[:, None])


def _similar(model: Model, time: float, radius: float) -> Curve:
    length = shape_measure(model, model.space.embedding_weights)
    here = model.time([time])
    sites = _sites(model, np.concatenate([breakpoints(model.time), model.times, [time]]))
    scale = radius * float(length(model.time(refined(sites, 4)) - here).max(initial=0.0))
    if scale == 0:
        return Curve(sites, np.ones((len(sites), 1)))

    def weight(times: Float) -> Float:
        return np.asarray(np.exp(-0.5 * np.square(length(model.time(times) - here) / scale))[:, None])

    return sampled(weight, sites, ACCURACY, lambda deviations: np.abs(deviations[:, 0]))


def _sites(model: Model, knots: Float) -> Float:
    """Return the sites of the time signal with more breakpoints; those outside it are ignored."""
    ends = np.array([model.time.start, model.time.end])
    if ends[0] == ends[1]:
        return model.time.times
    return sites_of(ends, knots[(knots > ends[0]) & (knots < ends[1])])


def smoothstep(times: Float, start: float, end: float) -> Float:
    """Return the C2 step ``(N,)`` from 0 until `start` to 1 from `end` on, of three cubics of equal length."""
    x = np.clip((times - start) / (end - start), 0.0, 1.0) * 3.0
    return np.asarray(
        (x**3 - 3.0 * np.maximum(x - 1.0, 0.0) ** 3 + 3.0 * np.maximum(x - 2.0, 0.0) ** 3) / 6.0
    )
