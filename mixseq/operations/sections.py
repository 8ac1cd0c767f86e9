r"""Splines over time, and exact concatenation of sections of motions: what operations on models share.

A rotation is interpolated from :math:`R_a` to :math:`R_b` along the turn between them,

.. math:: R_a \exp(w\, \tau), \qquad \exp(\tau) = R_a^T R_b,

which is unwrapped over time, as one motion may turn more than the other by whole turns. Centres are interpolated
linearly.

A section of a cubic spline is a cubic spline. At a *seam* value, slope and curvature jump by :math:`d_0, d_1, d_2`. The
jump is distributed to both sides by C2 offsets, each a cubic spline of three cubics on a window next to the seam:

.. math:: p(u) = \sum_{j=1}^3 a_j\, (r_j - u)_+^3, \qquad u = |t - t_\text{seam}|, \qquad r_j = j / 3 \cdot \text{fade}

They end smoothly for any coefficients :math:`a_j`, which follow from the three jumps. So the result is a cubic spline,
equal to the sections outside the windows. Its knots are those of the sections, seams and windows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

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
from mixseq.sequence.frame_rates import format_span, hint_frame_number
from mixseq.signals.curve import Curve
from mixseq.signals.detail import Measure, largest
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.temporal import Poses
from mixseq.types import Float, Index


def centre_columns(space: ShapeSpace) -> Index:
    """Return the indices ``(g, 3)`` of part centres in a placement."""
    return np.arange(4 * space.rotation_count, space.placement_dim).reshape(-1, 3)


def continued(space: ShapeSpace, curve: Curve, start: float, reference: Float) -> Curve:
    """Return the placement with quaternion signs that continue a reference ``(P,)`` at `start`: the same motion."""
    here, before = (space.poses(each).rotations[0] for each in (curve([start]), reference[None]))
    signs = np.where(np.einsum("gi,gi->g", here, before) < 0, -1.0, 1.0)
    if (signs > 0).all():
        return curve
    turns, centres = space.poses(curve.values)
    return Curve(curve.times, space.placements(Poses(turns * signs[:, None], centres)))


def mean(one: Float, other: Float, share: Float) -> Float:
    """Return weighted means ``(N, ...)`` with the weight `share` ``(N, ...)`` of `other`."""
    return np.asarray((1.0 - share) * one + share * other)


def mean_placements(space: ShapeSpace, one: Float, other: Float, share: Float) -> Float:
    """Return means ``(N, P)`` of placements with the weight `share` ``(N, 1)`` of `other`."""
    first, second = space.poses(one), space.poses(other)
    length, longer = (np.linalg.norm(poses.rotations, axis=2, keepdims=True) for poses in (first, second))
    a, b = (Poses(normalise_quat(poses.rotations), poses.centres) for poses in (first, second))
    share = share[:, :, None]
    # the shorter way at first
    ways = continuous_rotvec(quat_to_matrix(quat_multiply(quat_conjugate(a.rotations), b.rotations)))
    turns = quat_multiply(a.rotations, rotvec_to_quat(share * ways)) * mean(length, longer, share)
    return space.placements(Poses(turns, mean(a.centres, b.centres, share)))


ACCURACY = 1e-5
"""Largest error of signals between sites, in diagonals."""

ROUNDS = 6
"""Largest number of times that an interval between two sites is halved."""

EQUAL = 1e-8
"""Distance below which knots are equal, as a fraction of their mean distance."""


def breakpoints(curve: Curve) -> Float:
    """Return the times ``(n,)`` between cubics of the curve: all but the two outermost knots at each end."""
    return curve.times[2:-2]


def between(times: Float, start: float, end: float) -> Float:
    """Return the times strictly between the start and the end."""
    return times[(times > start) & (times < end)]


def sites_of(edges: Float, inner: Float) -> Float:
    """Return sites: breakpoints `edges` ``(n,)`` and `inner` ``(m,)``, and one more in both end intervals."""
    inner = np.unique(inner)
    close = EQUAL * (edges[-1] - edges[0]) / (len(edges) + len(inner))
    after = np.clip(np.searchsorted(edges, inner), 1, len(edges) - 1)
    nearest = np.minimum(np.abs(inner - edges[after - 1]), np.abs(inner - edges[after]))
    inner = inner[nearest > close]
    inner = inner[np.diff(inner, prepend=-np.inf) > close]
    breaks = np.sort(np.concatenate([edges, inner]))
    if len(breaks) == 2:
        return np.linspace(breaks[0], breaks[1], 4)
    return np.sort(np.concatenate([breaks, (breaks[[0, -2]] + breaks[[1, -1]]) / 2]))


def sites_between(start: float, end: float, knots: Float) -> Float:
    """Return sites from `start` to `end`, with those of the knots ``(m,)`` that are between them."""
    return sites_of(np.array([start, end]), between(knots, start, end))


def sites_within(model: Model, start: float, end: float, knots: Float | None = None) -> Float:
    """Return sites from `start` to `end`, with frames of the model, breakpoints of its signals, and knots ``(m,)``."""
    if start == end:
        return np.array([start])
    times = [*(breakpoints(curve) for curve in model.curves), model.times]
    return sites_between(start, end, np.concatenate(times if knots is None else [*times, knots]))


def refined(times: Float, parts: int) -> Float:
    """Return times ``(N,)`` with every interval between them divided into `parts`."""
    steps = np.arange(parts) / parts
    between = times[:-1, None] + steps * np.diff(times)[:, None]
    return np.append(between.reshape(-1), times[-1])


def moved(curve: Curve, scale: float, offset: float) -> Curve:
    """Return the curve with times t mapped to ``scale * t + offset``, reversed where the scale is negative."""
    times, values = scale * curve.times + offset, curve.values
    return Curve(times, values) if scale > 0 else Curve(times[::-1], values[::-1])


def sampled(function: Callable[[Float], Float], sites: Float, tolerance: float, measure: Measure) -> Curve:
    """Return the spline through a function of time, with sites ``(m,)`` refined until the tolerance holds."""
    for _ in range(ROUNDS):
        both = np.empty(2 * len(sites) - 1)
        both[::2], both[1::2] = sites, (sites[:-1] + sites[1:]) / 2
        values = function(both)
        curve, middles = Curve(sites, values[::2]), both[1::2]
        off = measure(curve(middles) - values[1::2]) > tolerance
        if not off.any():
            return curve
        sites = np.union1d(sites, middles[off])
    return Curve(sites, function(sites))


def window(times: Float, rise: tuple[float, float] | None, fall: tuple[float, float] | None) -> Float:
    """Return the weight ``(N,)`` of a window with a C2 rise and fall, from start to end each, None where it is open."""
    weight = np.ones(len(times))
    if rise is not None:
        weight *= smoothstep(times, *rise)
    if fall is not None:
        weight *= 1.0 - smoothstep(times, *fall)
    return weight


def smoothstep(times: Float, start: float, end: float) -> Float:
    """Return the C2 step ``(N,)`` from 0 until `start` to 1 from `end` on, of three cubics of equal length."""
    x = np.clip((times - start) / (end - start), 0.0, 1.0) * 3.0
    return np.asarray(
        (x**3 - 3.0 * np.maximum(x - 1.0, 0.0) ** 3 + 3.0 * np.maximum(x - 2.0, 0.0) ** 3) / 6.0
    )


def shape_measure(model: Model, metric: Float | None = None) -> Measure:
    """Return a measure of steps ``(N, k)`` in pose space: RMS over vertices in diagonals, by weights ``(S,)``."""
    shapes = model.shapes
    metric = model.space.shape_weights if metric is None else metric
    steps = model.pose.matrix @ (shapes - shapes[0]) * metric
    gram = steps @ steps.T / model.header.vertex_count
    return lambda changes: np.sqrt(np.maximum(np.einsum("na,ab,nb->n", changes, gram, changes), 0.0))


def placement_measure(model: Model) -> Measure:
    """Return the size ``(N,)`` of placement changes ``(N, P)``: the largest component, in diagonals."""
    return largest(model.space.weights[model.space.shape_dim :][: model.space.placement_dim])


def correction_measure(model: Model) -> Measure:
    """Return the size ``(N,)`` of correction changes ``(N, C)``: the largest component, in diagonals."""
    return largest(model.space.weights[model.space.shape_dim + model.space.placement_dim :])


def measures_of(model: Model) -> tuple[Measure, Measure, Measure]:
    """Return the measures of changes of `Model.curves`: time signal, placement and correction."""
    return shape_measure(model), placement_measure(model), correction_measure(model)


REACHES = np.array([1.0, 2.0, 3.0]) / 3.0
"""Ends of the three cubics of an offset, as fractions of the fade."""

NEAR = 0.02
"""Distance, as a fraction of the fade, below which ends of offsets move to a knot, as close knots lose digits."""

SLACK = 1e-3
"""Fraction of a frame by which times may miss a frame or a knot, as times are typed and printed with a few digits."""

SHORTEST = 1e-6
"""Shortest fade, as a fraction of the longest, at which its knots are distinct in float64."""


class CurveSection(NamedTuple):
    """A curve from `start` to `end`, in seconds."""

    curve: Curve
    start: float
    end: float


class Seam(NamedTuple):
    """The distribution of the jump between two sections."""

    fade: float  # seconds before and after the seam over which it is, not longer than the sections there
    # Fraction of the jump that is taken up before the seam: 1 leaves what follows as it is.
    share: float = 0.5


class ModelSection(NamedTuple):
    """A model from `start` to `end`, in seconds."""

    model: Model
    start: float
    end: float


def join(sections: Sequence[CurveSection], seams: Sequence[Seam]) -> Curve:
    """Concatenate consecutive sections of curves."""
    edges = np.array([sections[0].start, *(section.end for section in sections)])
    offsets: list[list[_Offset]] = [[] for _ in sections]
    for number, (before, after, seam) in enumerate(zip(sections, sections[1:], seams, strict=False)):
        jump = _jet(after.curve, after.start) - _jet(before.curve, before.end)
        for section, side, part in ((before, -1, seam.share), (after, 1, seam.share - 1)):
            if part:
                offset = _Offset.closing(part * jump, section, edges[number + 1], side, seam.fade)
                offsets[number + (side > 0)].append(offset)
    inner = [
        between(knots, start, end)
        for section, own, start, end in zip(sections, offsets, edges, edges[1:], strict=False)
        for knots in (breakpoints(section.curve), *(offset.knots for offset in own))
    ]
    sites = sites_of(edges, np.concatenate(inner))
    of_site = np.searchsorted(edges[1:-1], sites, side="left")
    values = np.concatenate(
        [
            section.curve(at) + sum((offset(at) for offset in own), start=np.zeros(()))
            for number, (section, own) in enumerate(zip(sections, offsets, strict=True))
            for at in (sites[of_site == number],)
        ]
    )
    return Curve(sites, values)


def _jet(curve: Curve, time: float) -> Float:
    """Return value, slope and curvature ``(3, k)`` at a time."""
    return np.concatenate([curve([time]), curve.derivative([time]), curve.derivative([time], 2)])


class _Offset(NamedTuple):
    """A spline of three truncated cubics, coefficients ``(3, k)``, on one side of a seam: -1 before it, 1 after it."""

    seam: float
    side: int
    reaches: Float
    coefficients: Float

    @classmethod
    def closing(cls, jet: Float, section: CurveSection, seam: float, side: int, fade: float) -> _Offset:
        """Make the offset with given value, slope and curvature ``(3, k)`` at the seam."""
        knots = between(breakpoints(section.curve), section.start, section.end)
        reaches = fade * REACHES
        away = side * (np.concatenate([knots, [section.start, section.end]]) - seam)
        for number, reach in enumerate(reaches):
            near = away[np.abs(away - reach) < NEAR * fade]
            if len(near):
                reaches[number] = near[np.abs(near - reach).argmin()]
        r = reaches / fade
        system = np.stack([r**3, -3.0 * r**2, 6.0 * r])
        scaled = jet * np.array([1.0, side * fade, fade**2])[:, None]
        return cls(seam, side, reaches, np.linalg.solve(system, scaled) / fade**3)

    @property
    def knots(self) -> Float:
        """Ends ``(3,)`` of its cubics, in seconds."""
        return self.seam + self.side * self.reaches

    def __call__(self, times: Float) -> Float:
        left = np.maximum(self.reaches - self.side * (times - self.seam)[:, None], 0.0)
        return np.asarray(left**3 @ self.coefficients)


# Models ---------------------------------------------------------------------------------------------------


def shifted(model: Model, seconds: float) -> Model:
    """Return the model moved to `seconds` later."""
    return affine(model, 1.0, seconds)


def affine(model: Model, scale: float, offset: float) -> Model:
    """Return the model with times t mapped to ``scale * t + offset``, reversed where the scale is negative."""
    times = scale * model.times + offset
    time, placement, correction = (moved(curve, scale, offset) for curve in model.curves)
    header = model.header.with_times(times if scale > 0 else times[::-1])
    return model.with_motion(time, placement, correction, header)


def concatenated(sections: Sequence[ModelSection], seams: Sequence[Seam]) -> Model:
    """Concatenate sections of models that share space, pose and shapes; a seam has the frame of the later section."""
    sections = going_on(sections)
    first = sections[0].model
    placements = [CurveSection(first.placement, sections[0].start, sections[0].end)]
    for model, start, end in sections[1:]:
        before = placements[-1]
        reference = before.curve([before.end])[0]
        curve = continued(model.space, model.placement, start, reference)
        placements.append(CurveSection(curve, start, end))
    return first.with_motion(
        join([CurveSection(model.time, start, end) for model, start, end in sections], seams),
        join(placements, seams),
        join([CurveSection(model.correction, start, end) for model, start, end in sections], seams),
        first.header.with_times(frames_of(sections)),
    )


def going_on(sections: Sequence[ModelSection]) -> Sequence[ModelSection]:
    """Return sections with continuous quaternions of parts, also after whole turns.

    Where the signs of quaternions change, all models get additional key shapes of the other signs, and pose coordinates
    for them. The models share space, pose and shapes, before and afterwards.
    """
    first = sections[0].model
    size, dim = first.space.pose_dim, first.time.dim
    signs = [np.ones(size)]
    for before, (model, start, _) in pairwise(sections):
        here, there = blended_poses(model, [start])[0], blended_poses(before.model, [before.end])[0]
        signs.append(model.space.signs(here, signs[-1] * there))
    numbers: dict[bytes, int] = {}
    kinds = [numbers.setdefault(each.tobytes(), len(numbers)) for each in signs]
    if len(numbers) == 1:
        return sections
    shapes = np.tile(first.shapes, (len(numbers), 1, 1))
    for kind, own in zip(kinds, signs, strict=True):
        shapes[kind, :, shapes.shape[2] - size :] = own * first.shapes[:, shapes.shape[2] - size :]
    rows, places = _distinct(shapes.reshape(-1, shapes.shape[2]))
    chosen = np.eye(len(rows))[places].reshape(len(numbers), -1, len(rows))
    offsets, matrices = first.pose.offset @ chosen, first.pose.matrix @ chosen
    blocks = [
        np.vstack([offset - offsets[0], matrix]) for offset, matrix in zip(offsets, matrices, strict=True)
    ]
    pose = PoseMap(offsets[0], np.concatenate(blocks)[1:])
    result = []
    for kind, (model, start, end) in zip(kinds, sections, strict=True):
        values = np.zeros((len(model.time.times), len(numbers) * (1 + dim)))
        values[:, kind * (1 + dim) : (kind + 1) * (1 + dim)] = np.insert(model.time.values, 0, 1.0, axis=1)
        time = Curve(model.time.times, values[:, 1:])
        result.append(ModelSection(replace(model, pose=pose, shapes=rows, time=time), start, end))
    return result


def blended_poses(model: Model, times: ArrayLike) -> Float:
    """Return the pose columns ``(N, pose_dim)`` of the shapes at times ``(N,)``."""
    columns = model.shapes[:, model.space.shape_dim - model.space.pose_dim :]
    return np.asarray(model.pose.weights(model.time(times)) @ columns)


def _distinct(rows: Float) -> tuple[Float, Index]:
    """Return the distinct rows ``(m, S)``, and the index of each row among them."""
    numbers: dict[bytes, int] = {}
    places = np.array([numbers.setdefault(row.tobytes(), len(numbers)) for row in rows], dtype=np.int64)
    return rows[np.unique(places, return_index=True)[1]], places


def frames_of(sections: Sequence[ModelSection]) -> Float:
    """Return the frame times ``(T,)`` of sections, increasing, or both ends; a frame at a seam is the later one's."""
    slack = 1e-6 / sections[0].model.header.fps
    start, end = sections[0].start, sections[-1].end
    times = [between(each.model.times, each.start - slack, each.end - slack) for each in sections]
    times.append(between(sections[-1].model.times, end - slack, end + slack))
    frames = np.clip(np.concatenate(times), start, end)
    return frames if len(frames) else np.array([start, end])


# Times ----------------------------------------------------------------------------------------------------


def snapped(model: Model, time: float, name: str = "time") -> float:
    """Return the time, or the end, frame or knot nearest to it within rounding."""
    slack = SLACK / model.header.fps
    if not model.start - slack <= time <= model.end + slack:
        fps = model.header.fps
        raise SettingsError(
            f"{name} is {time:g} s; the model is from {format_span(model.start, model.end, fps)}, give a time within"
            f"{hint_frame_number(time, model.start, model.end, fps)}"
        )
    known = np.concatenate([[model.start, model.end], model.times, *(curve.times for curve in model.curves)])
    nearest = float(known[np.abs(known - time).argmin()])
    return nearest if abs(nearest - time) <= slack else float(time)


def section_of(model: Model, start: float, end: float) -> tuple[float, float]:
    """Return the ends of a section, snapped as by `snapped`."""
    first, last = snapped(model, start, "start"), snapped(model, end, "end")
    if not first < last:
        raise SettingsError(f"there is no time between the start, {start:g} s, and the end, {end:g} s")
    return first, last


def fade_of(fade: float | None, longest: float) -> float:
    """Return the length of the windows next to a seam in seconds, by default a quarter of the longest possible."""
    if fade is None:
        return longest / 4
    shortest = SHORTEST * longest
    if not shortest <= fade <= longest * (1 + 1e-9):
        raise SettingsError(f"fade is {fade:g} s; {shortest:g} to {longest:g} s are expected")
    return min(float(fade), longest)
