"""Frame rates and frame numbers: exact values and their text.

NTSC rates are whole numbers times 1000/1001, such as 24000/1001 = 23.976023... With a rounded rate, frame numbers of a
shot that begins at frame 1001 would be wrong by a thousandth of a frame.

Frames have numbers besides their times, such as 1001 to 1096. The number n of a frame at the time t of a time line with
f frames per second is :math:`n = t f` in all files and messages, so a shot may begin at any time. In files that have
numbers but no times (``walk_1001.obj``, PC2), times follow from this formula; `SequenceHeader.numbered_from` changes
the first number. In Python frames are indexed from 0; messages show numbers.
"""

from __future__ import annotations

from math import isfinite
from typing import Annotated

Seconds = Annotated[float, "seconds"]
"""A time or duration that scripts may give as a number of frames."""

FRAME_TOLERANCE = 1e-3
"""Distance in frames up to which times snap to frames and knots, as times are typed and stored with few digits."""

FRAME_ROUNDING = 1e-9
"""Largest distance of a time from a frame that is a rounding error, in frames."""


def time_to_number(time: float, fps: float) -> float:
    """Return the frame number of a time in seconds, rounded to a whole number within `FRAME_TOLERANCE`."""
    number = float(time) * fps
    whole = float(round(number)) if isfinite(number) else number
    return whole if abs(number - whole) <= FRAME_TOLERANCE else number


def number_to_time(number: float, fps: float) -> float:
    """Return the time of a frame number in seconds."""
    return number / fps


def format_number(number: float) -> str:
    """Format a frame number: 1001.0 as "1001", 6.24 as "6.24"."""
    return f"{number + 0.0:.3f}".rstrip("0").rstrip(".")


def format_frame(time: float, fps: float) -> str:
    """Format the frame number of a time in seconds: "1001"."""
    return format_number(time_to_number(time, fps))


def format_frames(count: int, first: float, last: float) -> str:
    """Format a count of frames and their numbers: "96 (1001 to 1096)"."""
    numbers = dict.fromkeys(map(format_number, (first, last)))
    return f"{count:,} ({' to '.join(numbers)})"


def format_frame_range(start: float, end: float, fps: float) -> str:
    """Format the frame numbers of a time range in seconds: "frames 1001 to 1096" or "frame 12"."""
    numbers = dict.fromkeys(format_frame(time, fps) for time in (start, end))
    return f"frame{'s' if len(numbers) > 1 else ''} {' to '.join(numbers)}"


def format_span(start: float, end: float, fps: float) -> str:
    """Format a time range in seconds with its frame numbers: "41.7083 to 45.6667 s (frames 1001 to 1096)"."""
    return f"{start:g} to {end:g} s ({format_frame_range(start, end, fps)})"


def hint_frame_number(time: float, start: float, end: float, fps: float) -> str:
    """Return a hint if a time is probably a frame number, "; frame 1005 is at 41.875 s"; return "" for other times."""
    if not start - FRAME_TOLERANCE / fps <= number_to_time(time, fps) <= end + FRAME_TOLERANCE / fps:
        return ""
    return f"; frame {format_number(time)} is at {number_to_time(time, fps):g} s"


NTSC_RATES = tuple(1000 * whole / 1001 for whole in (24, 30, 48, 60, 120))

_NTSC_TOLERANCE_FPS = 0.005
"""Largest difference of an NTSC rate and its value rounded to two digits or more."""


def snap_to_ntsc(fps: float, base: float | None = None) -> float:
    """Replace a rounded NTSC rate (23.976) by the exact rate (24000/1001); keep other rates and multiples of `base`."""
    if base and fps > 0 and isfinite(fps):
        ratio = max(fps / base, base / fps)
        if abs(ratio - round(ratio)) < 1e-9:
            return fps
    return next((rate for rate in NTSC_RATES if abs(fps - rate) < _NTSC_TOLERANCE_FPS), fps)


def format_rate(fps: float) -> str:
    """Format a frame rate, NTSC rates as fractions: "24000/1001 (23.976)"."""
    for rate in NTSC_RATES:
        if abs(fps - rate) < 1e-9 * rate:
            return f"{round(1001 * rate)}/1001 ({rate:.3f})"
    return f"{fps:g}"
