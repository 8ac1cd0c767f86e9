r"""From one motion into another: concatenation, transitions, blends.

.. math:: s(t) = (1 - w(t))\, s_a(t) + w(t)\, s_b(t)

for all signals except rotations of bodies, which are interpolated along the rotation between both
(`mixseq.operations.sections`). The weight of a transition is the C2 step :math:`w = 6x^5 - 15x^4 + 10x^3`. The
product of weight and signal is approximated by a cubic spline through dense knots; the rest is exact. Before, both
models are put in one space, with the same key shapes, so that their signals can be added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.operations.sections import (
    SLACK,
    ModelSection,
    Seam,
    breakpoints,
    concatenated,
    continued,
    fade_of,
    frames_of,
    going_on,
    mean,
    mean_placements,
    refined,
    section_of,
    shifted,
    sites_between,
    snapped,
)
from mixseq.operations.timeline import carried, drift, place_of
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.signals.curve import Curve
from mixseq.signals.detail import Detail, build_model, encode_sequence
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.types import Float


@public
def into(model: Model, space: ShapeSpace) -> Model:
    """Return a model in another shape space of its mesh.

    Its frames are decoded and encoded again, and interpolated by cubic splines in the new space. They are equal as far
    as the new space represents the shapes exactly. A model in that space already is returned as it is.
    The residual layer is encoded with the frames, so the result has none.

    Parameters
    ----------
    model : Model
        The motion.
    space : ShapeSpace
        A space of the same mesh, in the same units.
    """
    if model.space is space:
        return model
    common, _, carry = space.merge(model.space)
    if common is space and carry is not None:
        return replace(model, space=space, shapes=carry(model.shapes))
    with one_blas_thread():
        return build_model(encode_sequence(model.sample(), space), Detail())


def together(first: Model, second: Model) -> tuple[Model, Model]:
    """Return two models of one mesh in one space, with the same pose and shape signals.

    The space is that of the first model. A basis space is extended to the shapes of both, or replaced by the second
    space if that is of another kind. Where key shapes differ, both models get all of them, with their weights as pose
    space.
    """
    _check_meshes(first, second)
    space, *carries = first.space.merge(second.space)
    first, second = (
        into(model, space) if carry is None else replace(model, space=space, shapes=carry(model.shapes))
        for model, carry in zip((first, second), carries, strict=True)
    )
    if _same_shapes(first, second):
        return first, replace(second, pose=first.pose, shapes=first.shapes)
    shapes = np.concatenate([first.shapes, second.shapes])
    pose = PoseMap.from_key_count(len(shapes))
    first, second = (
        replace(model, pose=pose, shapes=shapes, time=_weights_of(model, start, len(shapes)))
        for model, start in ((first, 0), (second, len(first.shapes)))
    )
    return first, second


def _weights_of(model: Model, start: int, count: int) -> Curve:
    """Return the weights of all but the first of `count` key shapes; those of the model begin at index `start`."""
    weights = np.zeros((len(model.time.times), count))
    weights[:, start : start + len(model.shapes)] = model.pose.weights(model.time.values)
    return Curve(model.time.times, weights[:, 1:])


def _same_shapes(first: Model, second: Model) -> bool:
    pairs = (
        (first.shapes, second.shapes),
        (first.pose.offset, second.pose.offset),
        (first.pose.matrix, second.pose.matrix),
    )
    return all(a is b or np.array_equal(a, b) for a, b in pairs)


def _check_meshes(first: Model, second: Model) -> None:
    a, b = first.header, second.header
    if a.vertex_count != b.vertex_count:
        raise InvalidSequenceError(
            f"{a.name!r} has {a.vertex_count} vertices, {b.name!r} {b.vertex_count}; two models of one mesh are needed"
        )
    if a.faces.shape != b.faces.shape or not np.array_equal(a.faces, b.faces):
        raise InvalidSequenceError(
            f"the faces of {a.name!r} and {b.name!r} differ; two models of one mesh, with the same order of vertices "
            "and faces, are needed"
        )


DENSE = 8
"""Knots of the approximating spline for each knot of the curve that it replaces."""

Weight = Callable[[Float], Float]


@public
def concatenate(a: Model, b: Model, fade: Seconds | None = None, travel: bool = False) -> Model:
    """Return one model after the other.

    The second one starts at the end time of the first. Jumps of value, slope and curvature of the signals are
    distributed to both sides. The residual layer is left out.

    Parameters
    ----------
    a, b : Model
        Models of one mesh. The result is in the space of `a`.
    fade : float, optional
        Seconds before and after the seam, at most the shorter model; by default a quarter of that.
    travel : bool
        Start the second model where the first ends along the ground (`travel_of`); heading and height stay. By default
        the second model keeps its place, and the body slides there.

    Raises
    ------
    InvalidSequenceError
        If the meshes differ.
    SettingsError
        If a model has no duration, the fade is out of range, or `travel` is set and the space has no placement.
    """
    a, b = together(a, b)
    start, seam = section_of(a, a.start, a.end)
    first, last = section_of(b, b.start, b.end)
    seconds = fade_of(fade, min(seam - start, last - first))
    if travel:
        b = carried(b, (place_of(a)([seam]) - place_of(b)([first]))[0])
    later = shifted(b, seam - first)
    return concatenated([ModelSection(a, start, seam), ModelSection(later, seam, later.end)], [Seam(seconds)])


@public
def transition(a: Model, b: Model, at: Seconds, duration: Seconds, travel: bool = False) -> Model:
    """Return the first model, which passes over into the second one.

    The residual layer is left out.

    Parameters
    ----------
    a, b : Model
        Models of one mesh. The result is in the space of `a`; its frames are those of `a` until the weight of `b` is 1,
        then those of `b`.
    at : float
        When the second model starts, in seconds of the first. Until then the result is `a`.
    duration : float
        Seconds until the result is `b`; both models cover them.
    travel : bool
        Continue the second model from the place that the first reaches along the ground; heading and height stay, and
        the ground speed is blended (`mixseq.operations.timeline`). By default the second model keeps its place.

    Raises
    ------
    InvalidSequenceError
        If the meshes differ.
    SettingsError
        If a time is out of range, or `travel` is set and the space has no placement.
    """
    if not (np.isfinite(duration) and duration > 0):
        raise SettingsError(f"duration is {duration}; a positive number of seconds is expected")
    a, b = together(a, b)
    at = snapped(a, at, "at")
    for which, left in (("first", a.end - at), ("second", b.end - b.start)):
        if duration > left + SLACK / a.header.fps:
            raise SettingsError(
                f"duration is {duration:g} s; the {which} model lasts for {left:g} s from there on"
            )
    later = shifted(b, at - b.start)
    end = min(snapped(later, at + duration), a.end, later.end)
    if not end - at > SLACK / a.header.fps:
        raise SettingsError(f"duration is {duration:g} s, next to no time; give more, or concatenate")
    if travel:
        later = carried(later, drift(a, later, (at, end), _step_slope(at, end))(np.array([end]))[0])
    a, later = (
        each.model for each in going_on([ModelSection(a, a.start, at), ModelSection(later, at, later.end)])
    )
    middle = _mix(a, later, (at, end), _step(at, end), parts=DENSE)
    if travel:
        apart = drift(a, later, (at, end), _step_slope(at, end))
        middle = carried(middle, apart(middle.placement.times))
    sections = [
        ModelSection(a, a.start, at),
        ModelSection(middle, at, end),
        ModelSection(later, end, later.end),
    ]
    # What little the points leave of jumps is taken up next to the ends of the middle, not to touch what is outside.
    point = (end - at) / (len(middle.time.times) - 1)
    seams = [Seam(3 * point, share=0.0), Seam(3 * point, share=1.0)]
    if sections[2].end - end <= 0:
        sections, seams = sections[:2], seams[:1]
    if at - a.start <= 0:
        sections, seams = sections[1:], seams[1:]
    return concatenated(sections, seams)


@public
def blend(a: Model, b: Model, weight: float | Curve) -> Model:
    """Return the mean of two models over the time that both have.

    The residual layer is left out.

    Parameters
    ----------
    a, b : Model
        Models of one mesh. The result is in the space of `a` and has its frames.
    weight : float or Curve
        Weight of `b`: 0 gives `a`, 1 gives `b`; a curve of one coordinate is the weight over time.

    Raises
    ------
    InvalidSequenceError
        If the meshes differ.
    SettingsError
        If the models share no time, or the weight is not finite or does not cover the shared time.
    """
    a, b = together(a, b)
    start, end = max(a.start, b.start), min(a.end, b.end)
    if not start < end:
        raise SettingsError(
            f"one model is from {a.start:g} to {a.end:g} s, the other from {b.start:g} to {b.end:g} s, with no time "
            "in common; shift one of them"
        )
    a, b = (each.model for each in going_on([ModelSection(a, a.start, start), ModelSection(b, start, b.end)]))
    if isinstance(weight, Curve):
        _check_weight(weight, start, end, SLACK / a.header.fps)
        inside = np.clip([start, end], weight.start, weight.end)
        parts = 1 if np.ptp(weight.values) == 0 else DENSE
        return _mix(
            a, b, (start, end), lambda times: weight(np.clip(times, *inside)), breakpoints(weight), parts
        )
    if not np.isfinite(weight):
        raise SettingsError(f"weight is {weight}; a number is expected")
    return _mix(a, b, (start, end), lambda times: np.full((len(times), 1), float(weight)))


def _check_weight(weight: Curve, start: float, end: float, slack: float) -> None:
    if weight.dim != 1:
        raise SettingsError(f"weight is a curve of {weight.dim} coordinates; one is expected")
    if weight.start > start + slack or weight.end < end - slack:
        raise SettingsError(
            f"weight is known from {weight.start:g} to {weight.end:g} s; {start:g} to {end:g} s are expected"
        )


def _step(start: float, end: float) -> Weight:
    """Return the C2 step from 0 to 1, with zero first and second derivatives at both ends."""

    def weight(times: Float) -> Float:
        x = (times[:, None] - start) / (end - start)
        return np.asarray(x**3 * (10.0 + x * (6.0 * x - 15.0)))

    return weight


def _step_slope(start: float, end: float) -> Weight:
    """Return the time derivative of `_step`, per second."""

    def slope(times: Float) -> Float:
        x = (times[:, None] - start) / (end - start)
        return np.asarray(30.0 * np.square(x * (1.0 - x)) / (end - start))

    return slope


def _mix(
    a: Model,
    b: Model,
    ends: tuple[float, float],
    weight: Weight,
    knots: Float | None = None,
    parts: int = 1,
) -> Model:
    """Blend two models of shared shapes over `ends`, with the frames of the first.

    `weight` maps times ``(N,)`` to ``(N, 1)``; `knots` ``(n,)`` are its breakpoints; `parts` subdivides knot intervals
    (1 is exact for a constant weight).
    """
    start, end = ends
    goes_on = continued(a.space, b.placement, start, a.placement([start])[0])

    def mixed(one: Curve, other: Curve, means: Callable[[Float, Float, Float], Float]) -> Curve:
        inner = [breakpoints(one), breakpoints(other), *([] if knots is None else [knots])]
        sites = refined(sites_between(start, end, np.concatenate(inner)), parts)
        return Curve(sites, means(one(sites), other(sites), weight(sites)))

    return a.with_motion(
        mixed(a.time, b.time, mean),
        mixed(a.placement, goes_on, partial(mean_placements, a.space)),
        mixed(a.correction, b.correction, mean),
        a.header.with_times(frames_of([ModelSection(a, start, end)])),
    )
