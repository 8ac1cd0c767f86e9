r"""Exact concatenation of sections of motions into one motion.

A section of a cubic spline is a cubic spline. At a *seam* value, slope and curvature jump by :math:`d_0, d_1, d_2`. The
jump is distributed to both sides by C2 offsets, each a cubic spline of three cubics on a window next to the seam:

.. math:: p(u) = \sum_{j=1}^3 a_j\, (r_j - u)_+^3, \qquad u = |t - t_\text{seam}|, \qquad r_j = j / 3 \cdot \text{fade}

They end smoothly for any coefficients :math:`a_j`, which follow from the three jumps. So the result is a cubic spline,
equal to the sections outside the windows. Its knots are those of the sections, seams and windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.errors import SettingsError
from mixseq.frame_numbers import seconds_meant, span_text
from mixseq.operations.placements import continued
from mixseq.operations.splines import between, breakpoints, moved, sites_of
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.signals.pose import PoseMap

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
        signs.append(model.space.signs(_poses(model, start), signs[-1] * _poses(before.model, before.end)))
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


def _poses(model: Model, time: float) -> Float:
    """Return the pose columns ``(pose_dim,)`` of the shape at a time."""
    columns = model.shapes[:, model.space.shape_dim - model.space.pose_dim :]
    return np.asarray(model.pose.weights(model.time([time]))[0] @ columns)


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
            f"{name} is {time:g} s; the model is from {span_text(model.start, model.end, fps)}, give a time within"
            f"{seconds_meant(time, model.start, model.end, fps)}"
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
