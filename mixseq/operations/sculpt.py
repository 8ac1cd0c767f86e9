r"""Edits of a frame by hand: applied over time, or in the place of a key shape.

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

import warnings
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.mesh.polygons import Polygons, difference
from mixseq.operations.sections import (
    breakpoints,
    refined,
    sampled,
    shape_measure,
    sites_between,
    snapped,
    window,
)
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.types import Float

MOVED, MOST = 1e-3, 0.9
"""Displacement of moved vertices, in diagonals, and their largest share in an edit without a warning."""


def edited_difference(model: Model, time: float, points: ArrayLike | MeshSequence) -> tuple[Model, Float]:
    """Return the model in a space that can represent the edit ``(V, 3)``, and its key shape difference ``(S,)``."""
    edited, before = checked_points(points, model.header), model(time)
    space, carry = model.space.extend(edited - before)
    model = replace(model, space=space, shapes=carry(model.shapes))
    _doubt(before, edited, time)
    return model, space.shape_difference(model.curve([time])[0], before, edited)


@public
def swap_key(model: Model, key: int, points: ArrayLike | MeshSequence) -> Model:
    """Put an edited mesh in the place of a key shape.

    For models whose key shapes are frames, ``mixseq.fit(sequence, pose="keys")``: the whole sequence follows the edit,
    in proportion to the weight of the key in every frame. The residual layer is kept.

    Parameters
    ----------
    model : Model
        The motion.
    key : int
        Number of the key shape, from 0 on, see `Model.key_frames`.
    points : (V, 3) array_like or MeshSequence of one frame
        That frame with vertices moved, in the units of the sequence.

    Raises
    ------
    SettingsError
        If there is no such key shape, or it is no frame of the model.
    InvalidSequenceError
        If the points are not those of the mesh, or not finite.
    """
    if not 0 <= key < len(model.shapes):
        raise SettingsError(f"key is {key}; the model has key shapes 0 to {len(model.shapes) - 1}")
    frame = int(model.key_frames[key])
    if frame < 0:
        raise SettingsError(
            f"key shape {key} is no frame of the model; fit one with pose='keys', or sculpt a frame instead"
        )
    time = float(model.times[frame])
    model, difference = edited_difference(model, time, points)
    shapes = np.array(model.shapes)
    shapes[key] += difference
    return replace(model, shapes=shapes)


def checked_points(points: ArrayLike | MeshSequence, header: SequenceHeader) -> Float:
    """Validate an edited frame of the mesh and return its points ``(V, 3)``."""
    if isinstance(points, MeshSequence):
        if points.frame_count != 1:
            raise SettingsError(f"the edited mesh has {points.frame_count} frames; one is expected")
        if points.vertex_count == header.vertex_count and not _same_surface(points.polygons, header.polygons):
            what = difference(points.polygons, header.polygons, ("the edited mesh", "the model"))
            raise InvalidSequenceError(
                f"the edited mesh has other edges than the model, {what}: vertices must keep their order; look for "
                "such a setting in the program that wrote it"
            )
        points = points.points[0]
    edited = np.asarray(points, dtype=np.float64)
    if edited.shape != (header.vertex_count, 3):
        raise InvalidSequenceError(
            f"the edited points have shape {edited.shape}; ({header.vertex_count}, 3) is expected: move the vertices "
            "of the decoded frame, but add none, take none away and keep their order"
        )
    if not np.isfinite(edited).all():
        vertex = int(np.flatnonzero(~np.isfinite(edited).all(axis=1))[0])
        raise InvalidSequenceError(f"vertex {vertex} of the edited points is not finite")
    return edited


def _doubt(before: Float, edited: Float, time: float) -> None:
    """Warn if most vertices were moved."""
    apart = np.linalg.norm(edited - before, axis=1) / (bounding_diagonal(before) or 1.0)
    moved = int(np.count_nonzero(apart > MOVED))
    if moved > MOST * len(edited):
        warnings.warn(
            f"{moved:,} of {len(edited):,} vertices moved, by up to {apart.max():.2g} diagonals; is the mesh the frame "
            f"at {time:g} s, in the axes and units of the model?",
            MixseqWarning,
            stacklevel=5,
        )


def _same_surface(one: Polygons, other: Polygons) -> bool:
    """Whether polygons have the same edges, except for diagonals where one of them is triangulated."""
    whole, cut = ({tuple(side) for side in _sides(polygons).tolist()} for polygons in (one, other))
    return whole <= cut or cut <= whole


def _sides(polygons: Polygons) -> NDArray[np.int64]:
    """Return the sides of polygons ``(E, 2)``, smaller vertex first."""
    ends = np.cumsum(polygons.counts)
    following = np.arange(1, len(polygons.indices) + 1)
    following[ends - 1] = ends - polygons.counts
    pairs = np.stack([polygons.indices, polygons.indices[following]], axis=1)
    return np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int64)


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
    rise, fall = None if first is None else (first, time), None if last is None else (time, last)
    return Curve(sites, window(sites, rise, fall)[:, None])


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
    if model.time.start == model.time.end:
        return model.time.times
    return sites_between(model.time.start, model.time.end, knots)
