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
from typing import TYPE_CHECKING, Annotated

if TYPE_CHECKING:
    from mixseq.types import Float

Seconds = Annotated[float, "seconds"]
"""A time or duration that scripts may give as a number of frames."""

FRAME_TOLERANCE = 1e-3  # distance, in frames, within which times snap, as they are typed and stored with few digits
FRAME_ROUNDING = 1e-9  # largest distance of a time from a frame that is a rounding error, in frames


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

_NTSC_TOLERANCE_FPS = 0.005  # largest difference of an NTSC rate and its value rounded to two digits or more


def snap_to_ntsc(fps: float, base: float | None = None) -> float:
    """Replace a rounded NTSC rate (23.976) by the exact rate (24000/1001); keep other rates and multiples of `base`."""
    if base and fps > 0 and isfinite(fps):
        ratio = max(fps / base, base / fps)
        if abs(ratio - round(ratio)) < 1e-9:
            return fps
    return next((rate for rate in NTSC_RATES if abs(fps - rate) < _NTSC_TOLERANCE_FPS), fps)


USUAL_RATES = (24.0, 30.0, 25.0, 60.0, 50.0, 48.0, 120.0, 100.0, 12.0, 15.0, 20.0, 10.0, *NTSC_RATES, 240.0)
"""Frame rates in Hz, the most common first."""

_RATE_ROUNDING = 2.0**-22  # largest relative error of a rate that was stored in single precision, or whose step was
_STEP_ROUNDING = 2e-4  # largest relative error of the rate of a single step, less than the distance of 24 from 23.976
MAX_GRID_RATE = 60.0  # highest rate in Hz whose frames alone are evidence; finer ones hold any hundredths as well
_EXACT_FRAMES = 1e-9  # largest distance of times from frames, in frames, that needs more than single precision


def snap_rate(fps: float, tolerance: float = _RATE_ROUNDING) -> float:
    """Return the usual, whole or NTSC rate within a relative tolerance of a rate, or else the rate."""
    if not (fps > 0 and isfinite(fps)):
        return fps
    candidates = (*USUAL_RATES, float(round(fps)), 1000 * round(1.001 * fps) / 1001)
    nearest = min(candidates, key=lambda rate: abs(rate - fps))
    return nearest if abs(nearest - fps) <= tolerance * fps else fps


def is_on_frames(times: Float, fps: float) -> bool:
    """Whether times ``(T,)`` in s are at frames of a rate, counted from 0 or from the first time."""
    return _distance_from_frames(times, fps) <= FRAME_TOLERANCE


def _distance_from_frames(times: Float, fps: float) -> float:
    """Return the largest distance of times from frames of a rate, in frames; see `is_on_frames`."""
    import numpy as np

    return min(float(np.abs(n - np.rint(n)).max()) for n in (times * fps, (times - times[0]) * fps))


def estimate_frame_rate(times: Float, declared: float = 0.0, lowest: float = 0.0) -> float | None:
    """Return the frame rate of increasing times ``(T,)`` in s, in which single precision may have left its rounding.

    It is that of even times, if at least `lowest`, or else the usual rate at whose frames all times are; None if there
    is no such rate. A declared rate that is not this one has precedence, since times may be on twos.

    Examples
    --------
    >>> import numpy as np
    >>> estimate_frame_rate(np.arange(60) * np.float32(1 / 30)), estimate_frame_rate(np.arange(60) / 29.97)
    (30.0, 29.97)
    >>> estimate_frame_rate((np.arange(96) / 29.97).astype(np.float32).astype(float)) == 30000 / 1001
    True
    >>> estimate_frame_rate(np.array([0.0, 1, 2, 5]) / 12), estimate_frame_rate(np.array([0.0, 0.5, 0.6]))
    (12.0, 30.0)
    """
    import numpy as np

    declared = snap_rate(declared) if isfinite(declared) and declared > 0 else 0.0
    span = float(times[-1] - times[0]) if times.size > 1 else 0.0
    if not (isfinite(span) and span > 0):
        return declared or None
    exact = snap_to_ntsc(declared)
    if _distance_from_frames(times, exact) < min(_distance_from_frames(times, declared) / 2, FRAME_TOLERANCE):
        declared = exact  # such as 23.98 of a file whose times are at 24000/1001
    rate = _rate_of_even_times(times, span) or 0.0
    if declared and abs(declared - rate) > _RATE_ROUNDING * declared:
        return declared
    if rate and rate >= lowest:
        return rate
    steps = np.diff(times)
    median = 1 / float(np.median(steps))
    likely = snap_rate(median, FRAME_TOLERANCE)
    # Times that are few and far apart do not determine a rate by their spacing.
    candidates = (likely, *USUAL_RATES) if median >= min(USUAL_RATES) else USUAL_RATES
    frequent = snap_rate(1 / float(np.quantile(steps, 0.5, method="lower")), _STEP_ROUNDING)
    fitting = [each for each in candidates if is_on_frames(times, each)]
    fine = next(iter(fitting), None)
    return next((each for each in fitting if each <= MAX_GRID_RATE), frequent if frequent in USUAL_RATES else fine)


def _rate_of_even_times(times: Float, span: float) -> float | None:
    """Return the rate of times ``(T,)`` that are one frame apart, or None if they are uneven.

    Several rates round to the same times: a usual rate is preferred, then that with the fewest digits.
    """
    import numpy as np

    count = times.size - 1
    rate, frames = count / span, np.arange(count + 1)
    distance = float(np.abs((times - times[0]) * rate - frames).max())
    if distance > FRAME_TOLERANCE:
        return None
    last = round(float(times[-1]) * rate)
    if last > count and abs(float(times[0]) * last / float(times[-1]) - (last - count)) <= FRAME_TOLERANCE:
        rate, span = last / float(times[-1]), float(times[-1])  # more precise, since it counts from frame 0
    error = max(2 * float(np.spacing(np.float32(np.abs(times).max()))) / span, _RATE_ROUNDING)
    if distance <= _EXACT_FRAMES:
        error = _RATE_ROUNDING
    usual = snap_rate(rate, max(error, FRAME_TOLERANCE))
    # Accumulated times drift from the frames of their rate, and rates such as 29.97 are rounded by exporters.
    drifts = distance > _EXACT_FRAMES and is_on_frames(times - times[0], usual)
    if abs(usual - rate) <= error * rate or drifts:
        return usual
    shortest = (round(rate, digits) for digits in range(4 if distance <= _EXACT_FRAMES else 6))
    return next((each for each in shortest if abs(each - rate) <= error * rate), float(f"{rate:.12g}"))


def format_rate(fps: float) -> str:
    """Format a frame rate, NTSC rates as fractions: "24000/1001 (23.976)"."""
    for rate in NTSC_RATES:
        if abs(fps - rate) < 1e-9 * rate:
            return f"{round(1001 * rate)}/1001 ({rate:.3f})"
    return f"{fps:g}"
