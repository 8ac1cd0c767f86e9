"""Sections of a motion: cut them out, repeat them, make them loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.operations.passes import (
    Pass,
    centre_columns,
    concatenated,
    fade_of,
    section_of,
    shifted,
)
from mixseq.operations.pieces import Fade
from mixseq.operations.timing import shift
from mixseq.sequence import UP_AXES
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model

MOST = 10_000
"""More passes of a section would be a slip."""


def cut(model: Model, start: float, end: float, at: float | None = None) -> Model:
    """Return a section of a model.

    The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion.
    start, end : float
        Section in seconds. The frames within it are the frames of the result, and its ends are the ends.
    at : float, optional
        Time at which the result starts, in seconds; by default times are kept.

    Raises
    ------
    SettingsError
        If the section is outside the model, does not last, or has no frame.
    """
    first, last = section_of(model, start, end)
    section = concatenated([Pass(model, first, last)], [])
    return section if at is None else shift(section, at - first)


def repeat(
    model: Model,
    start: float,
    end: float,
    times: int = 2,
    fade: float | None = None,
    travel: bool = False,
) -> Model:
    """Show a section of a model several times.

    The first pass comes from what is before the section, the last runs into what is after it, and neither of these
    changes, but for its time. Where one pass follows another, value, slope and curvature of all signals meet: what
    they jump by is taken up within the passes. The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion.
    start, end : float
        Section in seconds, such as one cycle of a walk.
    times : int
        How many times it is shown.
    fade : float, optional
        Seconds before and after every seam over which jumps are taken up, at most the section; by default a quarter
        of it.
    travel : bool
        Whether every pass starts where the one before got to: it is moved along the ground by the mean of what the
        parts moved by. It is not turned, nor moved up or down. A section should be a whole cycle.

    Raises
    ------
    SettingsError
        If the section is outside the model or does not last, a setting is out of range, or the space has no
        placement that could travel.
    """
    first, last = section_of(model, start, end)
    if not 1 <= times <= MOST:
        raise SettingsError(f"times is {times}; a section is shown 1 to {MOST:,} times")
    seconds = fade_of(fade, last - first)
    step = _travelled(model, first, last) if travel else np.zeros(3)
    passes = []
    for number in range(times):
        here = shifted(_translated(model, number * step), number * (last - first)) if number else model
        later = number * (last - first)
        passes.append(
            Pass(
                here,
                here.start if number == 0 else first + later,
                here.end if number == times - 1 else last + later,
            )
        )
    return concatenated(passes, [Fade(seconds)] * (times - 1))


def loop(model: Model, fade: float | None = None) -> Model:
    """Make the end of a model meet its start: value, slope and curvature of all signals.

    The last frame is the first one again. A part that turned by whole turns turns on. The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion, such as one cycle of a walk on the spot; `cut` makes one of a longer sequence.
    fade : float, optional
        Seconds at the start and at the end over which jumps are taken up, at most half the model; by default a
        quarter of that.

    Raises
    ------
    SettingsError
        If the model does not last, or the fade is out of range.
    """
    start, end = section_of(model, model.start, model.end)
    seconds, length = fade_of(fade, (end - start) / 2), end - start
    # The model twice: the second pass knows how to start after an end, the first how to end before a start.
    twice = concatenated(
        [Pass(model, start, end), Pass(shifted(model, length), start + length, end + length)],
        [Fade(seconds)],
    )
    middle = (start + end) / 2
    passes = [Pass(shifted(twice, -length), start, middle), Pass(twice, middle, end)]
    return concatenated(passes, [Fade(length / 4)])


def _travelled(model: Model, start: float, end: float) -> Float:
    """Return the mean of what the parts moved by along the ground ``(3,)``, in the space's unit."""
    columns = centre_columns(model.space)
    if not len(columns):
        raise SettingsError(
            f"the {model.space.name} space does not say where parts are, so nothing can travel; leave out travel"
        )
    places = model.placement([start, end])[:, columns].mean(axis=1)
    along_ground = np.array([axis != model.header.up_axis for axis in UP_AXES])
    return np.asarray((places[1] - places[0]) * along_ground)


def _translated(model: Model, offset: Float) -> Model:
    """Return the model with all parts moved by an offset ``(3,)`` in the space's unit."""
    placement = model.placement
    values = placement.values.copy()
    values[:, centre_columns(model.space)] += offset
    return replace(model, placement=Curve(placement.times, values))
