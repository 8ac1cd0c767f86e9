"""Edits of the time line: cut, repeat, loop, shift, change speed, reverse."""

from __future__ import annotations

import numpy as np

from mixseq.errors import SettingsError
from mixseq.frame_numbers import Seconds
from mixseq.operations.joining import (
    ModelSection,
    Seam,
    affine,
    concatenated,
    fade_of,
    section_of,
    shifted,
)
from mixseq.operations.travel import carried, step_of
from mixseq.public import public
from mixseq.signals.model import Model

MOST = 10_000
"""Largest number of repetitions of a section."""


@public
def cut(model: Model, start: Seconds, end: Seconds, at: Seconds | None = None) -> Model:
    """Return a section of a model.

    The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion.
    start, end : float
        Section in seconds. The result has its ends and the frames within it.
    at : float, optional
        Start time of the result, in seconds; by default times are kept.

    Raises
    ------
    SettingsError
        If the section is outside the model, has no duration, or has no frame.
    """
    first, last = section_of(model, start, end)
    section = concatenated([ModelSection(model, first, last)], [])
    return section if at is None else shift(section, at - first)


@public
def repeat(
    model: Model,
    start: Seconds,
    end: Seconds,
    times: int = 2,
    fade: Seconds | None = None,
    travel: bool = False,
) -> Model:
    """Show a section of a model several times.

    The motion before and after the section is only moved in time. At seams of the section with itself value, slope and
    curvature of all signals are made continuous by changes within it. The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion.
    start, end : float
        Section in seconds, such as one cycle of a walk.
    times : int
        Number of repetitions.
    fade : float, optional
        Seconds before and after every seam over which jumps are distributed, at most the section; by default a quarter
        of it.
    travel : bool
        Move every repetition along the ground by the travel of the section (`travel_of`), a whole cycle; heading and
        height stay.

    Raises
    ------
    SettingsError
        If the section is outside the model or has no duration, a setting is out of range, or `travel` is set and the
        space has no placement.
    """
    first, last = section_of(model, start, end)
    if not 1 <= times <= MOST:
        raise SettingsError(f"times is {times}; a section is shown 1 to {MOST:,} times")
    seconds = fade_of(fade, last - first)
    step = step_of(model, first, last) if travel else np.zeros(3)
    sections = []
    for number in range(times):
        here = shifted(carried(model, number * step), number * (last - first)) if number else model
        later = number * (last - first)
        sections.append(
            ModelSection(
                here,
                here.start if number == 0 else first + later,
                here.end if number == times - 1 else last + later,
            )
        )
    return concatenated(sections, [Seam(seconds)] * (times - 1))


@public
def loop(model: Model, fade: Seconds | None = None, travel: bool = False) -> Model:
    """Make the end of a model meet its start: value, slope and curvature of all signals.

    The last frame equals the first. A part that turned by whole turns turns on. The residual layer is left out.

    Parameters
    ----------
    model : Model
        The motion, such as one cycle of a walk; `cut` makes one of a longer sequence.
    fade : float, optional
        Seconds at the start and at the end over which jumps are distributed, at most half the model; by default a
        quarter of that.
    travel : bool
        Keep the travel along the ground (`travel_of`): the last frame equals the first except for its place. By default
        the body returns to its start.

    Raises
    ------
    SettingsError
        If the model has no duration, the fade is out of range, or `travel` is set and the space has no placement.
    """
    start, end = section_of(model, model.start, model.end)
    seconds, length = fade_of(fade, (end - start) / 2), end - start
    step = step_of(model, start, end) if travel else np.zeros(3)
    # The model twice: the second pass knows how to start after an end, the first how to end before a start.
    again = shifted(carried(model, step), length)
    twice = concatenated(
        [ModelSection(model, start, end), ModelSection(again, start + length, end + length)], [Seam(seconds)]
    )
    middle = (start + end) / 2
    second = shifted(carried(twice, -step), -length)
    sections = [ModelSection(second, start, middle), ModelSection(twice, middle, end)]
    return concatenated(sections, [Seam(length / 4)])


@public
def shift(model: Model, seconds: Seconds) -> Model:
    """Return the model with everything later by so many seconds, or earlier where they are negative.

    The residual layer is left out.

    Raises
    ------
    SettingsError
        If `seconds` is not finite.
    """
    if not np.isfinite(seconds):
        raise SettingsError(f"seconds is {seconds}; a number is expected")
    return shifted(model, float(seconds))


@public
def speed(model: Model, factor: float) -> Model:
    """Return the model so many times faster, from its start on.

    The frames stay the same; `Model.sample` and `mixseq.operations.resampling` make new ones. The residual layer is
    left out.

    Raises
    ------
    SettingsError
        If the factor is not positive.
    """
    if not (np.isfinite(factor) and factor > 0):
        raise SettingsError(f"factor is {factor}; a positive number is expected (reverse runs backwards)")
    return affine(model, 1.0 / factor, model.start * (1.0 - 1.0 / factor))


@public
def reverse(model: Model) -> Model:
    """Return the model backwards, from the same start to the same end.

    The residual layer is left out.
    """
    return affine(model, -1.0, model.start + model.end)
