r"""Splines over time and exact concatenation of motion sections, shared by the operations.

Rotations are interpolated from :math:`R_a` to :math:`R_b` along the rotation vector :math:`\tau` between them,

.. math:: R_a \exp(w\, \tau), \qquad \exp(\tau) = R_a^T R_b,

unwrapped over time, as one motion may make more whole turns than the other. Centres are interpolated linearly.

Splines interpolate values at *sites*: their breakpoints, and one additional time in the first and the last interval.

A section of a cubic spline is a cubic spline. At a *seam*, value, slope and curvature jump by :math:`d_0, d_1, d_2`.
The jump is distributed before and after the seam by C2 offsets of three cubics each, on a window next to the seam:

.. math:: p(u) = \sum_{j=1}^3 a_j\, (r_j - u)_+^3, \qquad u = |t - t_\text{seam}|, \qquad r_j = j / 3 \cdot \text{fade}

The offsets end smoothly for any coefficients :math:`a_j`; the three jumps determine these. Where two motions meet, the
jumps in slope and curvature have an offset of their own, with the length of a frame. The result is a cubic spline
that equals the sections outside the windows. Its knots are the knots of the sections, the seams and the window knots.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.mesh.rotations import (
    continuous_rotvec,
    normalise_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    rotvec_to_quat,
)
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, format_span, hint_frame_number
from mixseq.signals.curve import Curve
from mixseq.signals.detail import DeviationNorm, max_norm
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.temporal import Poses
from mixseq.types import Float, Index


def centre_columns(space: ShapeSpace) -> Index:
    """Return the column indices ``(g, 3)`` of body centres in a placement."""
    return np.arange(4 * space.rotation_count, space.placement_dim).reshape(-1, 3)


def align_quaternion_signs(space: ShapeSpace, placement: Curve, time: float, reference: Float) -> Curve:
    """Flip quaternion signs of a placement curve to match a reference placement ``(P,)`` at a time."""
    before = space.unpack_placements(reference[None]).rotations[0]
    after = space.unpack_placements(placement([time])).rotations[0]
    signs = np.where(np.einsum("gi,gi->g", after, before) < 0, -1.0, 1.0)
    if (signs > 0).all():
        return placement
    quaternions, centres = space.unpack_placements(placement.values)
    return Curve(placement.times, space.pack_placements(Poses(quaternions * signs[:, None], centres)))


def lerp(a: Float, b: Float, weight: Float) -> Float:
    """Interpolate linearly from a to b ``(N, ...)`` with the weight ``(N, ...)`` of b."""
    return np.asarray((1.0 - weight) * a + weight * b)


def blend_placements(space: ShapeSpace, a: Float, b: Float, weight: Float) -> Float:
    """Blend placements ``(N, P)`` with the weight ``(N, 1)`` of b."""
    first, second = space.unpack_placements(a), space.unpack_placements(b)
    norm_a, norm_b = (np.linalg.norm(poses.rotations, axis=2, keepdims=True) for poses in (first, second))
    rotation_a, rotation_b = (normalise_quat(poses.rotations) for poses in (first, second))
    weight = weight[:, :, None]
    # the shortest rotation at the first time, unwrapped from there
    turns = continuous_rotvec(quat_to_matrix(quat_multiply(quat_conjugate(rotation_a), rotation_b)))
    rotations = quat_multiply(rotation_a, rotvec_to_quat(weight * turns)) * lerp(norm_a, norm_b, weight)
    return space.pack_placements(Poses(rotations, lerp(first.centres, second.centres, weight)))


MAX_BISECTIONS = 6  # largest number of bisections of an interval between two sites
MIN_KNOT_SPACING_RATIO = 1e-8  # distance below which two knots are merged, as a fraction of the mean knot distance


def breakpoints(curve: Curve) -> Float:
    """Return the interior breakpoints ``(n,)`` of splines, their sites without the two outermost at each end."""
    return np.concatenate([piece.times[2:-2] for piece in curve.pieces])


def left_limits(times: Float) -> Float:
    """Return increasing times, the first of two equal ones just before it, where curves still have their left value."""
    return np.where(np.append(np.diff(times) == 0, False), np.nextafter(times, -np.inf), times)


def strictly_between(times: Float, start: float, end: float) -> Float:
    """Return the times strictly between the start and the end."""
    return times[(times > start) & (times < end)]


def merge_sites(edges: Float, knots: Float, breaks: ArrayLike = ()) -> Float:
    """Return the sites of a spline with breakpoints `edges` ``(n,)`` and, unless too close, `knots` ``(m,)``.

    Where the curve breaks, at inner `breaks` that are no edges, there is one spline on each side.
    """
    inner = strictly_between(np.unique(breaks), edges[0], edges[-1])
    span = edges[-1] - edges[0]
    inner = inner[(np.abs(inner[:, None] - edges) > MIN_KNOT_SPACING_RATIO * span).all(axis=1)]
    if len(inner):
        splines = pairwise([edges[0], *inner, edges[-1]])
        pairs = ((np.array([a, *strictly_between(edges, a, b), b]), strictly_between(knots, a, b)) for a, b in splines)
        return np.concatenate([merge_sites(*pair) for pair in pairs])
    knots = np.unique(knots)
    min_distance = MIN_KNOT_SPACING_RATIO * span / (len(edges) + len(knots))
    after = np.clip(np.searchsorted(edges, knots), 1, len(edges) - 1)
    edge_distances = np.minimum(np.abs(knots - edges[after - 1]), np.abs(knots - edges[after]))
    knots = knots[edge_distances > min_distance]
    knots = knots[np.diff(knots, prepend=-np.inf) > min_distance]
    breaks = np.sort(np.concatenate([edges, knots]))
    if len(breaks) == 2:
        return np.linspace(breaks[0], breaks[1], 4)
    return np.sort(np.concatenate([breaks, (breaks[[0, -2]] + breaks[[1, -1]]) / 2]))


def sites_between(start: float, end: float, knots: Float) -> Float:
    """Return the sites of a spline from `start` to `end` that breaks at the knots ``(m,)`` in between."""
    return merge_sites(np.array([start, end]), strictly_between(knots, start, end))


def model_sites(model: Model, start: float, end: float, knots: Float | None = None) -> Float:
    """Return sites from `start` to `end` at frames of a model, breakpoints of its signals, and knots ``(m,)``."""
    if start == end:
        return np.array([start])
    times = [*(breakpoints(curve) for curve in model.curves), model.times]
    return sites_between(start, end, np.concatenate(times if knots is None else [*times, knots]))


def subdivide(times: Float, count: int) -> Float:
    """Divide every interval between times ``(N,)`` into `count` equal intervals."""
    fractions = np.arange(count) / count
    subdivided = times[:-1, None] + fractions * np.diff(times)[:, None]
    return np.append(subdivided.reshape(-1), times[-1])


def map_curve_times(curve: Curve, offset: float, scale: float = 1.0) -> Curve:
    """Map times t of a curve to ``scale * t + offset``; a negative scale reverses the curve."""
    times, values = scale * curve.times + offset, curve.values
    return Curve(times, values) if scale > 0 else Curve(times[::-1], values[::-1])


def interpolate_adaptively(
    function: Callable[[Float], Float], sites: Float, tolerance: float, norm: DeviationNorm
) -> Curve:
    """Interpolate a function of time by a spline, bisecting intervals of the sites ``(m,)`` to reach the tolerance."""
    for _ in range(MAX_BISECTIONS):
        times = np.empty(2 * len(sites) - 1)
        times[::2], times[1::2] = sites, (sites[:-1] + sites[1:]) / 2
        values = function(times)
        curve, middles = Curve(sites, values[::2]), times[1::2]
        refine_mask = norm(curve(middles) - values[1::2]) > tolerance
        if not refine_mask.any():
            return curve
        sites = np.union1d(sites, middles[refine_mask])
    return Curve(sites, function(sites))


def fade_window(times: Float, rise: tuple[float, float] | None, fall: tuple[float, float] | None) -> Float:
    """Return weights ``(N,)`` with a C2 rise and fall over given time intervals; None omits the rise or the fall."""
    weight = np.ones(len(times))
    if rise is not None:
        weight *= smoothstep(times, *rise)
    if fall is not None:
        weight *= 1.0 - smoothstep(times, *fall)
    return weight


def smoothstep(times: Float, start: float, end: float) -> Float:
    """Return a C2 step ``(N,)`` from 0 at `start` to 1 at `end`, made of three cubics of equal length."""
    x = np.clip((times - start) / (end - start), 0.0, 1.0) * 3.0
    cubics = x**3 - 3.0 * np.maximum(x - 1.0, 0.0) ** 3 + 3.0 * np.maximum(x - 2.0, 0.0) ** 3
    return np.asarray(cubics / 6.0)


class KeyWeights(NamedTuple):
    """Weights of the changes of a model at K times: 1 at their own time and 0 at the others, C2."""

    times: Float  # (K,)
    start: float  # start and end of the full change
    end: float
    fade: float
    model: Model

    def ramps(self, number: int) -> tuple[tuple[float, float] | None, tuple[float, float] | None]:
        """Return the rise and the fall of a weight; None at the ends of the model."""
        times = self.times
        rise = (times[number - 1], times[number]) if number else (self.start - self.fade, self.start)
        is_last = number == len(times) - 1
        fall = (self.end, self.end + self.fade) if is_last else (times[number], times[number + 1])
        return None if rise[1] <= self.model.start else rise, None if fall[0] >= self.model.end else fall

    def at(self, times: Float) -> Float:
        """Return the weights ``(N, K)`` at times ``(N,)``."""
        return np.stack([fade_window(times, *self.ramps(number)) for number in range(len(self.times))], axis=1)

    @property
    def knots(self) -> Float:
        """Knots ``(n,)`` of all weights, and their times."""
        ramps = (ramp for number in range(len(self.times)) for ramp in self.ramps(number) if ramp is not None)
        return np.concatenate([self.times, *(np.linspace(*ramp, 4) for ramp in ramps)])

    @property
    def sites(self) -> Float:
        """Sites ``(m,)`` of signals of the model where a weight is not zero."""
        first, last = max(self.start - self.fade, self.model.start), min(self.end + self.fade, self.model.end)
        return model_sites(self.model, first, last, self.knots)


def shape_norm(model: Model, metric: Float | None = None) -> DeviationNorm:
    """Return the norm of pose-space steps ``(N, k)``, an RMS in diagonals with shape coordinate weights ``(S,)``."""
    metric = model.space.shape_weights if metric is None else metric
    jacobian = model.pose.matrix @ (model.shapes - model.shapes[0]) * metric
    gram = jacobian @ jacobian.T / model.header.vertex_count
    return lambda steps: np.sqrt(np.maximum(np.einsum("na,ab,nb->n", steps, gram, steps), 0.0))


def placement_norm(model: Model) -> DeviationNorm:
    """Return the norm of placement changes ``(N, P)``, the largest component in diagonals."""
    return max_norm(model.space.weights[model.space.shape_dim :][: model.space.placement_dim])


def correction_norm(model: Model) -> DeviationNorm:
    """Return the norm of correction changes ``(N, C)``, the largest component in diagonals."""
    return max_norm(model.space.weights[model.space.shape_dim + model.space.placement_dim :])


def signal_norms(model: Model) -> tuple[DeviationNorm, DeviationNorm, DeviationNorm]:
    """Return a norm for each of `Model.curves`: time signal, placement and correction."""
    return shape_norm(model), placement_norm(model), correction_norm(model)


OFFSET_KNOT_RATIOS = np.array([1.0, 2.0, 3.0]) / 3.0  # ends of the three cubics of an offset, as fractions of the fade
KNOT_SNAP_RATIO = 0.02  # distance, in fades, within which window knots snap to knots, as close knots lose digits
MIN_FADE_RATIO = 1e-6  # shortest allowed fade, as a fraction of the longest, so that knots are distinct in float64


class CurveSection(NamedTuple):
    """A curve from `start` to `end`, in seconds."""

    curve: Curve
    start: float
    end: float


class Seam(NamedTuple):
    """Distribution of the jump between two sections over windows before and after it."""

    fade: float  # length of the window on each side of the seam, in seconds; at most the length of the section
    fraction_before: float = 0.5  # fraction of the jump distributed before the seam; 1 keeps the later section exact
    # Length of the windows of slope and curvature, by default `fade`. Both are uncertain at the ends of curves, and
    # offsets grow with the length times the slope, and with its square times the curvature.
    slope_fade: float | None = None


class ModelSection(NamedTuple):
    """A model from `start` to `end`, in seconds."""

    model: Model
    start: float
    end: float


def motion_seam(model: Model, fade: float) -> Seam:
    """Return the seam of two motions: jumps in value over the fade, in slope and curvature over a frame."""
    return Seam(fade, slope_fade=1.0 / model.header.fps)


def join_curves(sections: Sequence[CurveSection], seams: Sequence[Seam]) -> Curve:
    """Concatenate consecutive sections of curves, with jumps at the seams distributed."""
    edges = np.array([sections[0].start, *(section.end for section in sections)])
    offsets: list[list[_SeamOffset]] = [[] for _ in sections]
    for index, (before, after, seam) in enumerate(zip(sections, sections[1:], seams, strict=False)):
        jump = _jet(after.curve, after.start) - _jet(before.curve, before.end)
        fraction, slope_jump = seam.fraction_before, jump * np.array([0.0, 1.0, 1.0])[:, None]
        jumps = [(jump, seam.fade)]
        if seam.slope_fade is not None:
            jumps = [(jump - slope_jump, seam.fade), (slope_jump, min(seam.slope_fade, seam.fade))]
        for section, side, scale in ((before, -1, fraction), (after, 1, fraction - 1)):
            for jet, fade in jumps if scale else ():
                offset = _SeamOffset.from_jet(scale * jet, section, edges[index + 1], side, fade)
                offsets[index + (side > 0)].append(offset)
    knots = [
        strictly_between(times, start, end)
        for section, own, start, end in zip(sections, offsets, edges, edges[1:], strict=False)
        for times in (breakpoints(section.curve), *(offset.knots for offset in own))
    ]
    breaks = [strictly_between(section.curve.breaks, section.start, section.end) for section in sections]
    sites = merge_sites(edges, np.concatenate(knots), np.concatenate(breaks))
    section_ids = np.searchsorted(edges[1:-1], sites, side="left")
    min_distance = MIN_KNOT_SPACING_RATIO * (edges[-1] - edges[0])
    values = []
    for index, (section, own) in enumerate(zip(sections, offsets, strict=True)):
        times = left_limits(sites)[section_ids == index]
        at_end = section.curve.breaks[np.abs(section.curve.breaks - section.end) <= min_distance]
        if len(at_end):
            times = np.minimum(times, np.nextafter(at_end[0], -np.inf))
        values.append(section.curve(times) + sum((offset(times) for offset in own), start=np.zeros(())))
    return Curve(sites, np.concatenate(values))


def splice(model: Model, curve: Curve, inside: Curve) -> Curve:
    """Replace the section of a signal `curve` that the curve `inside` covers.

    The first and last interval of `inside` absorb the jumps at its ends, which are interpolation errors.
    """
    first, last = inside.start, inside.end
    if first == last:
        return inside
    sections, seams = [CurveSection(inside, first, last)], []
    if model.start < first:
        sections.insert(0, CurveSection(curve, model.start, first))
        seams.append(Seam(inside.times[2] - first, fraction_before=0.0))
    if last < model.end:
        sections.append(CurveSection(curve, last, model.end))
        seams.append(Seam(last - inside.times[-3], fraction_before=1.0))
    return join_curves(sections, seams)


def _jet(curve: Curve, time: float) -> Float:
    """Return value, slope and curvature ``(3, k)`` of a curve at a time."""
    return np.concatenate([curve([time]), curve.derivative([time]), curve.derivative([time], 2)])


class _SeamOffset(NamedTuple):
    """An offset of three truncated cubics on one side of a seam."""

    seam: float
    side: int  # -1 before the seam, 1 after it
    reaches: Float  # (3,) distances from the seam to the ends of the cubics, in seconds
    coefficients: Float  # (3, k)

    @classmethod
    def from_jet(cls, jet: Float, section: CurveSection, seam: float, side: int, fade: float) -> _SeamOffset:
        """Solve for the offset with value, slope and curvature ``(3, k)`` at the seam."""
        knots = strictly_between(breakpoints(section.curve), section.start, section.end)
        reaches = fade * OFFSET_KNOT_RATIOS
        distances = side * (np.concatenate([knots, [section.start, section.end]]) - seam)
        for index, reach in enumerate(reaches):
            close = distances[np.abs(distances - reach) < KNOT_SNAP_RATIO * fade]
            if len(close):
                reaches[index] = close[np.abs(close - reach).argmin()]
        r = reaches / fade
        system = np.stack([r**3, -3.0 * r**2, 6.0 * r])
        scaled = jet * np.array([1.0, side * fade, fade**2])[:, None]
        return cls(seam, side, reaches, np.linalg.solve(system, scaled) / fade**3)

    @property
    def knots(self) -> Float:
        """Times ``(3,)`` at which the cubics end."""
        return self.seam + self.side * self.reaches

    def __call__(self, times: Float) -> Float:
        ramps = np.maximum(self.reaches - self.side * (times - self.seam)[:, None], 0.0)
        return np.asarray(ramps**3 @ self.coefficients)


def map_times(model: Model, offset: float, scale: float = 1.0) -> Model:
    """Map times t of a model to ``scale * t + offset``; a negative scale reverses the model."""
    times = scale * model.times + offset
    time, placement, correction = (map_curve_times(curve, offset, scale) for curve in model.curves)
    header = model.header.with_times(times if scale > 0 else times[::-1])
    return model.edited(header=header, time=time, placement=placement, correction=correction)


def join_models(sections: Sequence[ModelSection], seams: Sequence[Seam]) -> Model:
    """Concatenate sections of models with common space, pose and shapes; at a seam, use the later section's frame."""
    sections = align_part_quaternions(sections)
    first = sections[0].model
    placements = [CurveSection(first.placement, sections[0].start, sections[0].end)]
    for model, start, end in sections[1:]:
        before = placements[-1]
        reference = before.curve([before.end])[0]
        curve = align_quaternion_signs(model.space, model.placement, start, reference)
        placements.append(CurveSection(curve, start, end))
    return first.edited(
        header=first.header.with_times(merge_frame_times(sections)),
        time=join_curves([CurveSection(model.time, start, end) for model, start, end in sections], seams),
        placement=join_curves(placements, seams),
        correction=join_curves([CurveSection(model.correction, start, end) for model, start, end in sections], seams),
    )


def align_part_quaternions(sections: Sequence[ModelSection]) -> Sequence[ModelSection]:
    """Make part quaternions continuous from section to section, even after whole turns.

    If quaternion signs differ between sections, all models get additional key shapes with flipped signs, and pose
    coordinates for them. Both the given and the returned models share space, pose and shapes.
    """
    first = sections[0].model
    width = 1 + first.time.dim
    bodies = [(first.space, first.shapes), *((body.space, body.shapes) for body in first.bodies)]
    signs = np.concatenate([_shape_signs(space, shapes, sections) for space, shapes in bodies], axis=1)
    variants: dict[bytes, int] = {}
    variant_ids = [variants.setdefault(sign.tobytes(), len(variants)) for sign in signs]
    if len(variants) == 1:
        return sections
    columns = np.concatenate([shapes for _, shapes in bodies], axis=1)
    shapes = np.stack([signs[variant_ids.index(variant)] * columns for variant in range(len(variants))])
    unique_shapes, shape_ids = _unique_rows(shapes.reshape(-1, shapes.shape[2]))
    selections = np.eye(len(unique_shapes))[shape_ids].reshape(len(variants), -1, len(unique_shapes))
    offsets, matrices = first.pose.offset @ selections, first.pose.matrix @ selections
    blocks = np.concatenate([(offsets - offsets[0])[:, None], matrices], axis=1)
    pose = PoseMap(offsets[0], blocks.reshape(-1, len(unique_shapes))[1:])
    own, *others = np.split(unique_shapes, np.cumsum([shapes.shape[1] for _, shapes in bodies])[:-1], axis=1)
    extended = tuple(replace(body, shapes=shapes) for body, shapes in zip(first.bodies, others, strict=True))
    result = []
    for variant, (model, start, end) in zip(variant_ids, sections, strict=True):
        values = np.zeros((len(model.time.times), len(variants) * width))
        values[:, variant * width : (variant + 1) * width] = np.insert(model.time.values, 0, 1.0, axis=1)
        time = Curve(model.time.times, values[:, 1:])
        joined = replace(model, pose=pose, shapes=own, time=time, bodies=extended)
        result.append(ModelSection(joined, start, end))
    return result


def _shape_signs(space: ShapeSpace, shapes: Float, sections: Sequence[ModelSection]) -> Float:
    """Return factors ``(sections, S)`` of key shapes ``(K, S)`` that keep part quaternions continuous at seams."""
    signs = np.ones((len(sections), space.shape_dim))
    columns = shapes[:, space.shape_dim - space.pose_dim :]
    for number, (before, (model, start, _)) in enumerate(pairwise(sections)):
        ends = (before.model, before.end), (model, start)
        reference, poses = (each.pose.weights(each.time([time]))[0] @ columns for each, time in ends)
        before_sign = signs[number, space.shape_dim - space.pose_dim :]
        signs[number + 1, space.shape_dim - space.pose_dim :] = space.quaternion_signs(poses, before_sign * reference)
    return signs


def add_key_shapes(model: Model, shapes: Float, time: Curve, **changes: Any) -> Model:
    """Add key shapes ``(n, S)``, whose weights are the last n coordinates of a new time signal."""
    (dim, keys), count = model.pose.matrix.shape, len(shapes)
    matrix = np.pad(model.pose.matrix, ((0, count), (0, count)))
    matrix[dim:, 0], matrix[dim:, keys:] = -1.0, np.eye(count)
    pose = PoseMap(np.pad(model.pose.offset, (0, count)), matrix)
    return model.edited(time=time, pose=pose, shapes=np.concatenate([model.shapes, shapes]), **changes)


def blend_key_poses(model: Model, times: ArrayLike) -> Float:
    """Return blended part poses ``(N, pose_dim)`` of the key shapes at times ``(N,)``."""
    columns = model.shapes[:, model.space.shape_dim - model.space.pose_dim :]
    return np.asarray(model.pose.weights(model.time(times)) @ columns)


def _unique_rows(rows: Float) -> tuple[Float, Index]:
    """Return the distinct rows ``(m, S)`` of an array ``(n, S)``, in order of appearance, and their index ``(n,)``."""
    ids_of_rows: dict[bytes, int] = {}
    ids = np.array([ids_of_rows.setdefault(row.tobytes(), len(ids_of_rows)) for row in rows], dtype=np.int64)
    return rows[np.unique(ids, return_index=True)[1]], ids


def merge_frame_times(sections: Sequence[ModelSection]) -> Float:
    """Return the frame times ``(T,)`` of joined sections, or both ends if none; seams use the later section's frame."""
    slack = 1e-6 / sections[0].model.header.fps
    start, end = sections[0].start, sections[-1].end
    times = [strictly_between(model.times, start - slack, end - slack) for model, start, end in sections]
    times.append(strictly_between(sections[-1].model.times, end - slack, end + slack))
    frames = np.clip(np.concatenate(times), start, end)
    return frames if len(frames) else np.array([start, end])


def snap_time(model: Model, time: float, name: str = "time") -> float:
    """Snap a time to the nearest end, frame or knot of a model within `FRAME_TOLERANCE`."""
    slack = FRAME_TOLERANCE / model.header.fps
    if not model.start - slack <= time <= model.end + slack:
        fps = model.header.fps
        raise SettingsError(
            f"{name} is {time:g} s; the model is from {format_span(model.start, model.end, fps)}, give a time within"
            f"{hint_frame_number(time, model.start, model.end, fps)}"
        )
    knots = (curve.times for curve in model.curves)
    targets = np.concatenate([[model.start, model.end], model.times, *knots])
    nearest = float(targets[np.abs(targets - time).argmin()])
    return nearest if abs(nearest - time) <= slack else float(time)


def snap_section(model: Model, start: float, end: float) -> tuple[float, float]:
    """Snap the start and end of a section by `snap_time`."""
    first, last = snap_time(model, start, "start"), snap_time(model, end, "end")
    if not first < last:
        raise SettingsError(f"there is no time between the start, {start:g} s, and the end, {end:g} s")
    return first, last


def check_fade(fade: float | None, max_fade: float) -> float:
    """Validate a fade in seconds and return it; the default is a quarter of `max_fade`."""
    if fade is None:
        return max_fade / 4
    min_fade = MIN_FADE_RATIO * max_fade
    if not min_fade <= fade <= max_fade * (1 + 1e-9):
        raise SettingsError(f"fade is {fade:g} s; give {min_fade:g} to {max_fade:g} s")
    return min(float(fade), max_fade)
