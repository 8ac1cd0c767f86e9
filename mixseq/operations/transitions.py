r"""Join or blend two motions: concatenation, transitions and weighted blends.

.. math:: s(t) = (1 - w(t))\, s_a(t) + w(t)\, s_b(t)

for all signals except body rotations, which are interpolated along the rotation between both motions
(`mixseq.operations.sections`). The weight of a transition is the C2 step :math:`w = 6x^5 - 15x^4 + 10x^3`. Products of
weights and signals are approximated by cubic splines with dense knots; other sections are exact. Both models are first
converted to one space with the same key shapes, so that their signals can be added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from mixseq.compression.numbering import match_headers, with_mesh_of
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.operations.sections import (
    ModelSection,
    Seam,
    align_part_quaternions,
    align_quaternion_signs,
    blend_placements,
    breakpoints,
    check_fade,
    join_models,
    lerp,
    map_times,
    merge_frame_times,
    motion_seam,
    sites_between,
    snap_section,
    snap_time,
    subdivide,
)
from mixseq.operations.timeline import cut, ground_drift, ground_position, translate
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, Seconds
from mixseq.sequence.sequence import FrameStore, MeshSequence, load_frames
from mixseq.signals.curve import Curve
from mixseq.signals.detail import Detail, build_model, encode_sequence
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.temporal import Timing
from mixseq.types import Float


@public
def into(model: Model, space: ShapeSpace) -> Model:
    """Convert a model into another shape space of its mesh.

    The frames are decoded, encoded in the new space, and interpolated by cubic splines there. They do not change if the
    new space represents their shapes exactly. A model already in this space is returned unchanged.

    Parameters
    ----------
    model : Model
        The motion.
    space : ShapeSpace
        A space of the same mesh, in the same units.
    """
    return model if model.space is space else _encode(model.sample(), space, model.timing)


def match_spaces(first: Model, second: Model) -> tuple[Model, Model]:
    """Bring two models of one mesh into one space, with the same pose and shape signals.

    The common space is the space of the first model, with its numbers of vertices if those of the second model differ,
    as in compressed files of another order. If key shapes differ, both models get all key shapes, with weights
    as pose space. Further bodies of the first model stay if it has all key shapes.
    """
    second = _encode_like(second, first)
    arrays = ((model.shapes, model.pose.offset, model.pose.matrix) for model in (first, second))
    if all(a is b or np.array_equal(a, b) for a, b in zip(*arrays, strict=True)):
        return first, replace(second, pose=first.pose, shapes=first.shapes, bodies=first.bodies)
    if first.bodies:
        raise SettingsError(
            f"{second.header.name!r} has other key shapes than {first.header.name!r}, and its bodies "
            f"{', '.join(first.body_names[1:])} have none of these poses; join motions before they are transferred"
        )
    second = replace(second, bodies=())
    shapes = np.concatenate([first.shapes, second.shapes])
    pose = PoseMap.from_key_count(len(shapes))
    first, second = (
        replace(model, pose=pose, shapes=shapes, time=_key_weight_signal(model, start, len(shapes)))
        for model, start in ((first, 0), (second, len(first.shapes)))
    )
    return first, second


def _key_weight_signal(model: Model, start: int, count: int) -> Curve:
    """Return the weights of key shapes 1 to `count` - 1 as a time signal; the model's key shapes begin at `start`."""
    weights = np.zeros((len(model.time.times), count))
    weights[:, start : start + len(model.shapes)] = model.pose.weights(model.time.values)
    return Curve(model.time.times, weights[:, 1:])


def _encode_like(model: Model, first: Model) -> Model:
    """Return a model in the space of another one, and with its numbers of vertices if those of the mesh differ."""
    a, b = first.header, model.header
    if a.vertex_count == b.vertex_count and np.array_equal(a.faces, b.faces):
        return into(model, first.space)
    numbering = match_headers(b, a)
    if numbering is None:
        raise InvalidSequenceError(
            f"{a.name!r} has {a.vertex_count} vertices, {b.name!r} {b.vertex_count}, or other faces; two models of one "
            "mesh are needed"
        )
    frames = load_frames(with_mesh_of(model.sample(), a, numbering.vertices))
    return _encode(frames, first.space, model.timing)


def _encode(frames: FrameStore | MeshSequence, space: ShapeSpace, timing: Timing) -> Model:
    with one_blas_thread():
        return build_model(encode_sequence(frames, space, timings=[timing]), Detail())


SITES_PER_BLENDED_KNOT = 8  # number of sites of an approximating spline per knot of the curve that the spline replaces


@public
def concatenate(a: FileOr[Model], b: FileOr[Model], fade: Seconds | None = None, travel: bool = False) -> Model:
    """Concatenate two models.

    The second model starts at the end time of the first. Jumps in value are distributed before and after the seam, and
    jumps in slope and curvature over a frame, so that frames change only if the motions do not meet.

    Parameters
    ----------
    a, b : Model
        Models of one mesh. The result is in the space of `a`.
    fade : float, optional
        Seconds before and after the seam over which jumps are distributed; at most the duration of the shorter model,
        by default a quarter of the maximum.
    travel : bool
        Start the second model at the ground position where the first ends (`travel_of`), with unchanged heading and
        height. By default the second model keeps its position, and the body slides there.

    Raises
    ------
    InvalidSequenceError
        If the meshes differ.
    SettingsError
        If a model has no duration, the fade is out of range, or `travel` is set and the space has no placement.
    """
    a, b = cast("Model", a), cast("Model", b)
    a, b = match_spaces(a, b)
    start, seam = snap_section(a, a.start, a.end)
    first, last = snap_section(b, b.start, b.end)
    fade = check_fade(fade, min(seam - start, last - first))
    if travel:
        b = translate(b, (ground_position(a)([seam]) - ground_position(b)([first]))[0])
    b = map_times(b, seam - first)
    return join_models([ModelSection(a, start, seam), ModelSection(b, seam, b.end)], [motion_seam(a, fade)])


@public
def transition(
    a: FileOr[Model],
    b: FileOr[Model],
    at: Seconds,
    duration: Seconds,
    travel: bool = False,
    enter: Seconds | None = None,
) -> Model:
    """Blend from one model into another.

    Parameters
    ----------
    a, b : Model
        Models of one mesh. The result is in the space of `a`; its frames are those of `a` until the weight of `b` is 1,
        then those of `b`.
    at : float
        Time in `a` at which `b` starts, in seconds. Until then the result is `a`.
    duration : float
        Duration of the blend in seconds, after which the result is `b`. Both models must cover the blend.
    travel : bool
        Continue `b` from the ground position that `a` reaches, with unchanged heading and height. The ground speed is
        blended (`mixseq.operations.timeline`). By default `b` keeps its position.
    enter : float, optional
        Time in `b` that is played at the time `at`, in seconds; by default its start.

    Raises
    ------
    InvalidSequenceError
        If the meshes differ.
    SettingsError
        If a time is out of range, or `travel` is set and the space has no placement.
    """
    a, b = cast("Model", a), cast("Model", b)
    if enter is not None:
        b = cut(b, enter, b.end)
    if not (np.isfinite(duration) and duration > 0):
        raise SettingsError(f"duration is {duration}; a positive number of seconds is expected")
    a, b = match_spaces(a, b)
    at = snap_time(a, at, "at")
    for name, remaining in (("first", a.end - at), ("second", b.end - b.start)):
        if duration > remaining + FRAME_TOLERANCE / a.header.fps:
            raise SettingsError(f"duration is {duration:g} s; the {name} model has {remaining:g} s left")
    b = map_times(b, at - b.start)
    end = min(snap_time(b, at + duration), a.end, b.end)
    if not end - at > FRAME_TOLERANCE / a.header.fps:
        raise SettingsError(f"duration is {duration:g} s; give a longer one, or concatenate the models")
    weight, weight_rate = (partial(step, start=at, end=end) for step in (_smooth_step, _smooth_step_rate))
    if travel:
        b = translate(b, ground_drift(a, b, at, end, weight_rate)(np.array([end]))[0])
    sections = align_part_quaternions([ModelSection(a, a.start, at), ModelSection(b, at, b.end)])
    a, b = (section.model for section in sections)
    middle = _blend_interval(a, b, at, end, weight, count=SITES_PER_BLENDED_KNOT)
    if travel:
        drift = ground_drift(a, b, at, end, weight_rate)
        middle = translate(middle, drift(middle.placement.times))
    sections = [ModelSection(a, a.start, at), ModelSection(middle, at, end), ModelSection(b, end, b.end)]
    # Remaining jumps are distributed only within the blended section, so that both models stay exact outside it.
    site_spacing = (end - at) / (len(middle.time.times) - 1)
    seams = [Seam(3 * site_spacing, fraction_before=0.0), Seam(3 * site_spacing, fraction_before=1.0)]
    if sections[2].end - end <= 0:
        sections, seams = sections[:2], seams[:1]
    if at - a.start <= 0:
        sections, seams = sections[1:], seams[1:]
    return join_models(sections, seams)


@public
def blend(a: FileOr[Model], b: FileOr[Model], weight: float | Curve) -> Model:
    """Blend two models over the time interval that both cover.

    Parameters
    ----------
    a, b : Model
        Models of one mesh. The result has the space and the frame times of `a`.
    weight : float or Curve
        Weight of `b`: 0 gives `a`, 1 gives `b`. A curve of one coordinate gives the weight over time.

    Raises
    ------
    InvalidSequenceError
        If the meshes differ.
    SettingsError
        If the models share no time, or the weight is not finite or does not cover the shared time.
    """
    a, b = cast("Model", a), cast("Model", b)
    a, b = match_spaces(a, b)
    start, end = max(a.start, b.start), min(a.end, b.end)
    if not start < end:
        raise SettingsError(
            f"one model is from {a.start:g} to {a.end:g} s, the other from {b.start:g} to {b.end:g} s, with no time "
            "in common; shift one of them"
        )
    sections = align_part_quaternions([ModelSection(a, a.start, start), ModelSection(b, start, b.end)])
    a, b = (section.model for section in sections)
    if isinstance(weight, Curve):
        if weight.dim != 1:
            raise SettingsError(f"weight is a curve of {weight.dim} coordinates; one is expected")
        slack = FRAME_TOLERANCE / a.header.fps
        if weight.start > start + slack or weight.end < end - slack:
            raise SettingsError(
                f"weight is a curve from {weight.start:g} to {weight.end:g} s; {start:g} to {end:g} s are expected"
            )
        limits = np.clip([start, end], weight.start, weight.end)
        count = 1 if np.ptp(weight.values) == 0 else SITES_PER_BLENDED_KNOT
        knots = breakpoints(weight)
        return _blend_interval(a, b, start, end, lambda times: weight(np.clip(times, *limits)), knots, count)
    if not np.isfinite(weight):
        raise SettingsError(f"weight is {weight}; a number is expected")
    return _blend_interval(a, b, start, end, lambda times: np.full((len(times), 1), float(weight)))


def _smooth_step(times: Float, start: float, end: float) -> Float:
    """Return a polynomial step ``(N, 1)`` from 0 to 1, with zero first and second derivatives at both ends."""
    x = (times[:, None] - start) / (end - start)
    return np.asarray(x**3 * (10.0 + x * (6.0 * x - 15.0)))


def _smooth_step_rate(times: Float, start: float, end: float) -> Float:
    """Return the time derivative ``(N, 1)`` of `_smooth_step`, per second."""
    x = (times[:, None] - start) / (end - start)
    return np.asarray(30.0 * np.square(x * (1.0 - x)) / (end - start))


def _blend_interval(
    a: Model,
    b: Model,
    start: float,
    end: float,
    weight: Callable[[Float], Float],
    knots: Float | None = None,
    count: int = 1,
) -> Model:
    """Blend two models with common key shapes over an interval, with the frames of the first model.

    The function `weight` maps times ``(N,)`` to weights ``(N, 1)`` and has breakpoints `knots` ``(n,)``. Every knot
    interval is divided into `count` intervals; 1 is exact for a constant weight.
    """
    aligned = align_quaternion_signs(a.space, b.placement, start, a.placement([start])[0])

    def blend_curves(one: Curve, other: Curve, mean: Callable[[Float, Float, Float], Float]) -> Curve:
        breaks = [breakpoints(one), breakpoints(other), *([] if knots is None else [knots])]
        sites = subdivide(sites_between(start, end, np.concatenate(breaks)), count)
        return Curve(sites, mean(one(sites), other(sites), weight(sites)))

    return a.edited(
        header=a.header.with_times(merge_frame_times([ModelSection(a, start, end)])),
        time=blend_curves(a.time, b.time, lerp),
        placement=blend_curves(a.placement, aligned, partial(blend_placements, a.space)),
        correction=blend_curves(a.correction, b.correction, lerp),
    )
