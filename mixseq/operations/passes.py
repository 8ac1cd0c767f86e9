"""One model from passes through models that share a space and key shapes; the frames are theirs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.errors import SettingsError
from mixseq.geometry.quaternions import normalised
from mixseq.operations.pieces import Fade, Piece, between, join, moved
from mixseq.prediction.poses import Poses
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.base import ShapeSpace

SLACK = 1e-3
"""Fraction of a frame by which times may miss a frame or a knot: they are typed and printed with a few digits."""

SHORTEST = 1e-6
"""Shortest fade, as a fraction of the longest: in a shorter one the digits of times do not tell its knots apart."""

DENSE = 8
"""A curve that is no cubic spline is made one by so many knots for each that it had."""


class Pass(NamedTuple):
    """What a model does from `start` to `end`, in seconds."""

    model: Model
    start: float
    end: float


def shifted(model: Model, seconds: float) -> Model:
    """Return the model with everything later by so many seconds."""
    return affine(model, 1.0, seconds)


def affine(model: Model, scale: float, offset: float) -> Model:
    """Return the model with its times t moved to ``scale * t + offset``; backwards where the scale is negative."""
    times = scale * model.times + offset
    return model.with_motion(
        moved(model.time, scale, offset),
        moved(model.placement, scale, offset),
        model.header.with_times(times if scale > 0 else times[::-1]),
    )


def concatenated(passes: Sequence[Pass], fades: Sequence[Fade]) -> Model:
    """Make one model of passes that follow each other, through models that share space, pose and shapes.

    Quaternions go on from pass to pass with the signs nearest for a body. The frames are those of the passes; where one
    passes into the next it is the frame of the next, if there is any.
    """
    first = passes[0].model
    placements = [Piece(first.placement, passes[0].start, passes[0].end)]
    for model, start, end in passes[1:]:
        before = placements[-1]
        reference = before.curve([before.end])[0]
        curve = continued(model.space, Piece(model.placement, start, end), reference)
        placements.append(Piece(curve, start, end))
    return first.with_motion(
        join([Piece(model.time, start, end) for model, start, end in passes], fades),
        join(placements, fades),
        first.header.with_times(frames_of(passes)),
    )


def frames_of(passes: Sequence[Pass]) -> Float:
    """Return the times ``(T,)`` of the frames of passes, increasing; both ends, if no frame is within.

    A frame at the end of a pass is left to the next one.
    """
    slack = 1e-6 / passes[0].model.header.fps
    start, end = passes[0].start, passes[-1].end
    times = [between(run.model.times, run.start - slack, run.end - slack) for run in passes]
    times.append(between(passes[-1].model.times, end - slack, end + slack))
    frames = np.clip(np.concatenate(times), start, end)
    return frames if len(frames) else np.array([start, end])


# Placements -----------------------------------------------------------------------------------------------


def centre_columns(space: ShapeSpace) -> Index:
    """Return which numbers ``(g, 3)`` of a placement are centres."""
    return np.arange(4 * space.rotation_count, space.placement_dim).reshape(-1, 3)


def continued(space: ShapeSpace, piece: Piece, reference: Float) -> Curve:
    """Return a piece of a placement whose quaternions begin with the signs nearest to given ones: the same motion.

    Parts of a body get one sign, so that they all go the same way round from one motion into the other, but for parts
    that would go by more than two thirds of a turn.

    Parameters
    ----------
    space : ShapeSpace
        The space.
    piece : Piece
        A placement.
    reference : (P,) float64
        Where the placement is before the piece.
    """
    curve, start, _ = piece
    here, before = (space.poses(each).rotations[0] for each in (curve([start]), reference[None]))
    cosines = np.einsum("gi,gi->g", normalised(here), normalised(before))
    together = np.bincount(space.bodies, cosines)[space.bodies]
    signs = np.where(np.where(np.abs(cosines) > 0.5, cosines, together) < 0, -1.0, 1.0)
    if (signs > 0).all():
        return curve
    turns, centres = space.poses(curve.values)
    return Curve(curve.times, space.placements(Poses(turns * signs[:, None], centres)))


# Times ----------------------------------------------------------------------------------------------------


def snapped(model: Model, time: float, name: str = "time") -> float:
    """Return the time, or the end, frame or knot that it misses by no more than rounding.

    Raises
    ------
    SettingsError
        If the time is outside the model.
    """
    slack = SLACK / model.header.fps
    if not model.start - slack <= time <= model.end + slack:
        raise SettingsError(
            f"{name} is {time:g} s; the model is from {model.start:g} to {model.end:g} s, give a time within"
        )
    known = np.concatenate([[model.start, model.end], model.times, model.time.times, model.placement.times])
    nearest = float(known[np.abs(known - time).argmin()])
    return nearest if abs(nearest - time) <= slack else float(time)


def section_of(model: Model, start: float, end: float) -> tuple[float, float]:
    """Return the ends of a section, see `snapped`.

    Raises
    ------
    SettingsError
        If an end is outside the model, or the section does not last.
    """
    first, last = snapped(model, start, "start"), snapped(model, end, "end")
    if not first < last:
        raise SettingsError(f"there is no time between the start, {start:g} s, and the end, {end:g} s")
    return first, last


def fade_of(fade: float | None, longest: float) -> float:
    """Return the length of the windows next to a seam: a quarter of the longest that is possible, or as given.

    Raises
    ------
    SettingsError
        If it is too short to tell from a jump, or longer than possible.
    """
    if fade is None:
        return longest / 4
    shortest = SHORTEST * longest
    if not shortest <= fade <= longest * (1 + 1e-9):
        raise SettingsError(f"fade is {fade:g} s; {shortest:g} to {longest:g} s are expected")
    return min(float(fade), longest)
