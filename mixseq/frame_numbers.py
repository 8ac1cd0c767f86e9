r"""Frame numbers: what people call the frames of a shot, 1001 to 1096, beside their times in seconds.

The number n of a frame at the time t of a time line with f frames per second is

.. math:: n = t f

in every file and on every screen, so that a shot need not begin at 0. Files that tell numbers and no times,
``walk_1001.obj`` or PC2, have their times by it; `SequenceHeader.numbered_from` makes a shot begin at another number.
In Python frames are counted from 0, by their *index*; people are told the number.
"""

from __future__ import annotations

from math import isfinite
from typing import Annotated

Seconds = Annotated[float, "seconds"]
"""A time, or how long something lasts: parameters that scripts may give as numbers of frames."""

NEAR = 1e-3
"""Fraction of a frame by which times may miss a whole number: they are typed, and stored, with a few digits."""


def number_at(time: float, fps: float) -> float:
    """Return the frame number of a time in seconds; a whole one, if the time misses it by rounding only.

    Examples
    --------
    >>> number_at(41.708333, 24), number_at(0.26, 24)
    (1001.0, 6.24)
    """
    number = float(time) * fps
    whole = float(round(number)) if isfinite(number) else number
    return whole if abs(number - whole) <= NEAR else number


def time_of(number: float, fps: float) -> float:
    """Return the time of a frame number in seconds.

    Examples
    --------
    >>> time_of(1002, 24)
    41.75
    """
    return number / fps


def number_text(number: float) -> str:
    """Return a frame number as it is shown.

    Examples
    --------
    >>> number_text(1001.0), number_text(6.24), number_text(-3)
    ('1001', '6.24', '-3')
    """
    return f"{number + 0.0:.3f}".rstrip("0").rstrip(".")


def frame_text(time: float, fps: float) -> str:
    """Return the frame number of a time, as it is shown.

    Examples
    --------
    >>> frame_text(1001 / 24, 24)
    '1001'
    """
    return number_text(number_at(time, fps))


def frames_text(count: int, first: float, last: float) -> str:
    """Return how many frames there are, and their numbers.

    Examples
    --------
    >>> frames_text(96, 1001.0, 1096.0)
    '96 (1001 to 1096)'
    """
    numbers = dict.fromkeys(map(number_text, (first, last)))
    return f"{count:,} ({' to '.join(numbers)})"


def frames_between(start: float, end: float, fps: float) -> str:
    """Return the numbers of the frames from when to when something is.

    Examples
    --------
    >>> frames_between(1001 / 24, 1096 / 24, 24), frames_between(0.5, 0.5, 24)
    ('frames 1001 to 1096', 'frame 12')
    """
    numbers = dict.fromkeys(frame_text(time, fps) for time in (start, end))
    return f"frame{'s' if len(numbers) > 1 else ''} {' to '.join(numbers)}"


def span_text(start: float, end: float, fps: float) -> str:
    """Return from when to when something is, with the numbers of the frames there.

    Examples
    --------
    >>> span_text(1001 / 24, 1096 / 24, 24)
    '41.7083 to 45.6667 s (frames 1001 to 1096)'
    """
    return f"{start:g} to {end:g} s ({frames_between(start, end, fps)})"


def seconds_meant(time: float, start: float, end: float, fps: float) -> str:
    """Return what somebody may have meant who gives a frame number for a time in seconds; nothing, if it is none.

    Examples
    --------
    >>> seconds_meant(1005, 1001 / 24, 1096 / 24, 24)
    '; frame 1005 is at 41.875 s'
    >>> seconds_meant(2000, 1001 / 24, 1096 / 24, 24)
    ''
    """
    if not start - NEAR / fps <= time_of(time, fps) <= end + NEAR / fps:
        return ""
    return f"; frame {number_text(time)} is at {time_of(time, fps):g} s"
