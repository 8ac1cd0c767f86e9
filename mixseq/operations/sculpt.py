r"""Apply a manual edit of one frame over time.

The shape space gives the difference :math:`\Delta` between the mesh at a time and the edited mesh
(`ShapeSpace.shape_difference`). It is independent of the placement of parts, so it can be added to any frame:

.. math:: s(t) = \sum_j \varphi_j(c(t))\, P_j + w(t)\, \Delta

The model gets an additional key shape, :math:`P_0 + \Delta`, and pose space an additional coordinate, the weight w. It
is 1 at the edited time. At other times it is, by the parameter `where`:

everywhere
    1;
window
    0 outside a window, with a C2 rise and fall inside;
similar
    :math:`\exp(-(d / r)^2 / 2)`, with the distance d in the shape space between the shapes at t and at the edited time.
    The radius r is given as a fraction of the largest distance d in the model.
"""

from __future__ import annotations

import warnings
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from mixseq.compression.numbering import match_vertices
from mixseq.errors import InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.mesh.polygons import Polygons, describe_difference
from mixseq.operations.sections import (
    add_key_shapes,
    breakpoints,
    fade_window,
    interpolate_adaptively,
    shape_norm,
    sites_between,
    snap_time,
    subdivide,
)
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.frame_rates import Seconds
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.types import Float

MIN_DISPLACEMENT = 1e-3  # displacement above which a vertex counts as moved, in diagonals
MAX_MOVED_RATIO = 0.9  # fraction of moved vertices above which an edit causes a warning


def check_edited_points(points: ArrayLike | MeshSequence, header: SequenceHeader) -> Float:
    """Validate an edited frame of the mesh and return its points ``(V, 3)``."""
    if isinstance(points, MeshSequence):
        if points.frame_count != 1:
            raise SettingsError(f"the edited mesh has {points.frame_count} frames; one is expected")
        if points.vertex_count == header.vertex_count:
            edges, expected = _edges(points.polygons), _edges(header.polygons)
            vertex_ids = match_vertices(points, header)
            if vertex_ids is not None:
                points = points.with_points(points.points[:, vertex_ids])
            elif not (edges <= expected or expected <= edges):  # either mesh may be triangulated
                names = ("the edited mesh", "the model")
                details = describe_difference(points.polygons, header.polygons, names)
                raise InvalidSequenceError(
                    f"the edited mesh has other edges than the model, {details}; export it again with the vertex "
                    "order kept"
                )
        points = next(points.blocks(1))[0]
    edited = np.asarray(points, dtype=np.float64)
    if edited.shape != (header.vertex_count, 3):
        raise InvalidSequenceError(
            f"the edited points have shape {edited.shape}; ({header.vertex_count}, 3) is expected: move the vertices "
            "of the decoded frame; do not add, remove or reorder any"
        )
    if not np.isfinite(edited).all():
        vertex = int(np.flatnonzero(~np.isfinite(edited).all(axis=1))[0])
        raise InvalidSequenceError(f"vertex {vertex} of the edited points is not finite")
    return edited


def _warn_of_large_edit(original: Float, edited: Float, time: float) -> None:
    """Warn if more than `MAX_MOVED_RATIO` of the vertices were moved."""
    distances = np.linalg.norm(edited - original, axis=1) / (bounding_diagonal(original) or 1.0)
    moved_count = int(np.count_nonzero(distances > MIN_DISPLACEMENT))
    if moved_count > MAX_MOVED_RATIO * len(edited):
        warnings.warn(
            f"{moved_count:,} of {len(edited):,} vertices moved, by up to {distances.max():.2g} diagonals; is the mesh "
            f"the frame at {time:g} s, in the axes and units of the model?",
            MixseqWarning,
            stacklevel=4,
        )


def _edges(polygons: Polygons) -> set[tuple[int, int]]:
    """Return the edges of polygons as vertex pairs, smaller index first."""
    ends = np.cumsum(polygons.counts)
    next_corners = np.arange(1, len(polygons.indices) + 1)
    next_corners[ends - 1] = ends - polygons.counts
    edges = np.sort(np.stack([polygons.indices, polygons.indices[next_corners]], axis=1), axis=1)
    return {(first, second) for first, second in edges.tolist()}


Where = Literal["everywhere", "window", "similar"]

DEFAULT_RADIUS = 0.25  # default radius of similarity, as a fraction of the distance to the least similar shape
WEIGHT_TOLERANCE = 1e-3  # largest error of the sampled weight between sites


@public
def sculpt(
    model: Model,
    time: Seconds,
    points: FileOr[ArrayLike | MeshSequence],
    where: Where = "everywhere",
    start: Seconds | None = None,
    end: Seconds | None = None,
    radius: float | None = None,
) -> Model:
    """Apply a manual edit of one frame to other times.

    Parameters
    ----------
    model : Model
        The motion.
    time : float
        Time of the edited mesh in seconds; it may be between frames.
    points : (V, 3) array_like or MeshSequence of one frame
        The edited mesh in the file's units: ``model(time)`` with moved vertices, in the same order.
    where : {"everywhere", "window", "similar"}
        Weight of the edit over time, see the module docstring.
    start, end : float, optional
        For "window": the window in seconds; by default open to the start or the end of the model.
    radius : float, optional
        For "similar": distance at which the weight is 0.61, as a fraction of the distance to the least similar shape;
        by default 0.25.

    Raises
    ------
    InvalidSequenceError
        If the points do not belong to the mesh, or are not finite.
    SettingsError
        If a time is outside the model or the window, or settings contradict each other.
    """
    points = cast("ArrayLike | MeshSequence", points)
    _check_settings(where, start, end, radius)
    time = snap_time(model, time)
    edited, original = check_edited_points(points, model.header), model(time)
    _warn_of_large_edit(original, edited, time)
    difference = model.space.shape_difference(model.curve([time])[0], original, edited)
    if where == "window":
        weight = _window_weight(model, time, start, end)
    elif where == "similar":
        weight = _similarity_weight(model, time, DEFAULT_RADIUS if radius is None else radius)
    else:
        weight = Curve(model.time.times, np.ones((len(model.time.times), 1)))
    return add_key_shape(model, difference, weight)


def _check_settings(where: Where, start: float | None, end: float | None, radius: float | None) -> None:
    if where not in get_args(Where):
        raise SettingsError(f"where is {where!r}; {', '.join(map(repr, get_args(Where)))} is expected")
    if where == "window" and start is None and end is None:
        raise SettingsError("a window needs a start or an end; give one, or where='everywhere'")
    if where != "window" and not (start is None and end is None):
        raise SettingsError(f"start and end are of a window; leave them out, or where={where!r}")
    if where != "similar" and radius is not None:
        raise SettingsError(f"radius is of where='similar'; leave it out, or where={where!r}")
    if radius is not None and not (np.isfinite(radius) and radius > 0):
        raise SettingsError(f"radius is {radius}; a positive fraction of the largest distance is expected")


def add_key_shape(model: Model, difference: Float, weight: Curve) -> Model:
    """Add a key shape with a difference ``(S,)`` and a weight curve; its sites include those of the time signal."""
    time = Curve(weight.times, np.concatenate([model.time(weight.times), weight.values], axis=1))
    return add_key_shapes(model, model.shapes[:1] + difference, time)


def _window_weight(model: Model, time: float, start: float | None, end: float | None) -> Curve:
    """Return the weight of a window as an exact cubic spline."""
    first = None if start is None else snap_time(model, start, "start")
    last = None if end is None else snap_time(model, end, "end")
    if (first is not None and not first < time) or (last is not None and not time < last):
        limits = " and ".join(
            f"{name} {value:g} s" for name, value in (("start", start), ("end", end)) if value is not None
        )
        raise SettingsError(f"the window has {limits}; the sculpted time, {time:g} s, must be within")
    knots = [breakpoints(model.time)]
    knots += [np.linspace(first, time, 4)] if first is not None else []
    knots += [np.linspace(time, last, 4)] if last is not None else []
    sites = weight_sites(model, np.concatenate(knots))
    rise, fall = None if first is None else (first, time), None if last is None else (time, last)
    return Curve(sites, fade_window(sites, rise, fall)[:, None])


def _similarity_weight(model: Model, time: float, radius: float) -> Curve:
    """Return the similarity weight; `radius` is relative to the largest distance from the shape at the edited time."""
    norm = shape_norm(model, model.space.embedding_weights)
    edited_point = model.time([time])
    sites = weight_sites(model, np.concatenate([breakpoints(model.time), model.times, [time]]))
    scale = radius * float(norm(model.time(subdivide(sites, 4)) - edited_point).max(initial=0.0))
    if scale == 0:
        return Curve(sites, np.ones((len(sites), 1)))

    def weight(times: Float) -> Float:
        distances = norm(model.time(times) - edited_point)
        return np.asarray(np.exp(-0.5 * np.square(distances / scale))[:, None])

    return interpolate_adaptively(weight, sites, WEIGHT_TOLERANCE, lambda errors: np.abs(errors[:, 0]))


def weight_sites(model: Model, knots: Float) -> Float:
    """Return sites over the duration of the time signal with the given knots inside it."""
    if model.time.start == model.time.end:
        return model.time.times
    return sites_between(model.time.start, model.time.end, knots)
