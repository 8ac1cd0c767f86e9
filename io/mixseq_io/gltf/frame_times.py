"""Times of the frames of a glTF animation."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError, SettingsError
from mixseq.frame_rates import NTSC_RATES, exact_rate
from mixseq.sequence import DEFAULT_FPS
from mixseq_io.key_times import MOST_PLAYED, SAME_TIME, on_grid, united

USUAL_RATES = (
    24.0,
    30.0,
    25.0,
    60.0,
    50.0,
    48.0,
    120.0,
    100.0,
    12.0,
    15.0,
    20.0,
    10.0,
    *NTSC_RATES,
)

_MOST_FRAMES = 1_000_000
_FASTEST_PLAYED = 60.0
"""Highest rate in Hz at which keys count as frames; finer grids are hundredths of seconds or ticks."""
_GAP = 1.5  # frames; a wider one has room for another
_GRID = 2e-3  # of a frame; keys are float32


def time_tolerance(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the difference ``(n,)`` in s below which times are equal: a microsecond or a float32 step."""
    return np.maximum(SAME_TIME, np.spacing(np.abs(times).astype(np.float32)).astype(np.float64))


def key_times(channels: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the times ``(n,)`` of all channels, increasing; equal times of two channels count once."""
    found = np.empty(0)
    for times in sorted(channels, key=len, reverse=True):
        found = united(found, times, time_tolerance(times))
    return found


def sampled_times(path: Path, keys: NDArray[np.float64], fps: float) -> NDArray[np.float64]:
    """Return times ``(n,)`` from the first key to the last, `fps` per second."""
    if not (np.isfinite(fps) and fps > 0):
        raise SettingsError(f"fps is {fps}; a positive number is expected")
    if not keys.size:
        return keys
    count = (keys[-1] - keys[0]) * fps + _GRID
    if not count < _MOST_FRAMES:
        raise FormatError(
            f"{path}: {keys[-1] - keys[0]:g} s at {fps:g} frames per second are too many frames"
        )
    times: NDArray[np.float64] = keys[0] + np.arange(int(count) + 1) / fps
    return times


def played_times(keys: NDArray[np.float64], rate: float) -> NDArray[np.float64]:
    """Return the times of keys ``(n,)``, and of the frames played in wider gaps between them.

    These are ``k / rate`` if the first key is on that grid, else ``rate`` per second from the first key on. Frames less
    than half a frame from a key are left out; nothing is added above 100 000 frames or where every frame has a key.

    Examples
    --------
    >>> played_times(np.array([0.5, 0.75, 2.1]), 4).tolist()
    [0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.1]
    """
    gaps = np.diff(keys) * rate
    wide = gaps > _GAP
    if not wide.any() or not gaps.sum() < MOST_PLAYED:
        return keys
    first = on_grid(keys[:1], rate)[0] * rate
    whole = np.rint(first)
    start = whole if abs(first - whole) < _GRID else first
    frames = (start + np.arange(int(gaps.sum()) + 2)) / rate
    after = np.searchsorted(keys, frames)
    inside = (after > 0) & (after < keys.size)
    frames, after = frames[inside], after[inside]
    room = np.minimum(frames - keys[after - 1], keys[after] - frames) * rate >= 0.5 - _GRID
    return np.union1d(keys, frames[room & wide[after - 1]])


def played_rate(keys: NDArray[np.float64]) -> float:
    """Return the frame rate of keys ``(n,)``: that of their grid, 24 if it is finer than 60."""
    rate = rate_of(keys)
    return rate if rate <= _FASTEST_PLAYED else DEFAULT_FPS


def rate_of(times: NDArray[np.float64]) -> float:
    """Return the frame rate of even keys ``(n,)``, else of the grid that they lie on, 24 if there is none.

    Examples
    --------
    >>> rate_of(np.arange(96) / np.float32(29.97)) == 30000 / 1001
    True
    >>> rate_of(np.array([0.0, 1, 2, 5]) / 12), rate_of(np.array([0.0, 0.5, 0.6]))
    (12.0, 30.0)
    """
    if times.size < 2:
        return DEFAULT_FPS
    even = _even_rate(times)
    if even:
        return even
    steps = times - times[0]
    own = 1 / float(np.median(np.diff(times)))
    likely = [rate for rate in USUAL_RATES if abs(rate - own) < 1e-3 * own] or [own]
    # A few distant keys determine no rate.
    for rate in (*(likely if own >= min(USUAL_RATES) else []), *USUAL_RATES):
        frames = steps * rate
        if np.abs(frames - np.rint(frames)).max() < _GRID:
            return rate
    return DEFAULT_FPS


def _even_rate(times: NDArray[np.float64]) -> float | None:
    """Return the rate of float32 keys ``(n,)`` at even frames, None for others and for keys far apart.

    Of the rates that round to the same keys it is a usual one, or else the one with the fewest digits.
    """
    count, span = times.size - 1, float(times[-1] - times[0])
    rounding = 2 * float(np.spacing(np.float32(np.abs(times).max())))
    rate = count / span if 0 < span < np.inf else 0.0
    if not rate >= min(USUAL_RATES):
        return None
    if not np.abs(times - times[0] - np.arange(count + 1) / rate).max() <= rounding:
        return None
    whole = round(float(times[-1]) * rate)
    if (
        whole > count
        and np.abs(times * (whole / times[-1]) - np.arange(whole - count, whole + 1)).max() < _GRID
    ):
        rate, span = whole / float(times[-1]), float(times[-1])  # of frames from 0 on, the most precise
    error = rate * rounding / span
    usual = min((*USUAL_RATES, round(rate * 1.001) / 1.001), key=lambda usual: abs(usual - rate))
    # also what was rounded when somebody typed it, 29.97, as long as that makes no difference
    if abs(usual - rate) <= max(error, _GRID * rate / count if exact_rate(rate) == usual else 0.0):
        return usual
    rounded = (round(rate, digits) for digits in range(6))
    return next((simple for simple in rounded if abs(simple - rate) <= error), rate)
