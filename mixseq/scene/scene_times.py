"""Frame times of a scene, whose meshes start together, and restart when the longest has ended.

Frame k is shown at :math:`k / f`, with f frames per second. The *period* is that of the longest mesh: the time from its
first frame to its last, and one frame. Shorter ones wait in their last pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.errors import SettingsError
from mixseq.frame_rates import exact_rate
from mixseq.sequence import SequenceHeader

STILL = 4.0
"""Duration of a film of a single pose, in seconds."""

MOST_FRAMES = 100_000
"""Largest number of frames, to catch wrong rates and durations."""


def film_times(
    headers: Sequence[SequenceHeader], fps: float | None = None, seconds: float | None = None
) -> tuple[Float, float]:
    """Return the frame times ``(N,)`` of a film since the meshes' first times, and its frames per second."""
    rate = headers[0].fps if fps is None else exact_rate(fps, headers[0].fps)
    period = max(_period(header) for header in headers)
    lasting = seconds or period or STILL
    wanted = lasting * rate
    if not 1.5 <= wanted < MOST_FRAMES:
        raise SettingsError(
            f"{lasting:g} s at {rate:g} frames per second are {wanted:.3g} frames; a film has from 2 to "
            f"{MOST_FRAMES:,}, change its duration or its rate"
        )
    elapsed = np.arange(round(wanted)) / rate
    if not period:
        return np.zeros_like(elapsed), rate
    rounds = np.floor(elapsed / period + 1e-9)
    # to nanoseconds, so that the same time is the same number in every round
    return np.maximum(np.round(elapsed - rounds * period, 9), 0.0), rate


def _period(header: SequenceHeader) -> float:
    if header.frame_count < 2:
        return 0.0
    return float(header.times[-1] - header.times[0]) + 1 / header.fps


def nearest_frames(header: SequenceHeader, elapsed: Float) -> Index:
    """Return the frames ``(N,)`` nearest to times since the first one, the earlier of two."""
    middles = (header.times[1:] + header.times[:-1]) / 2 - header.times[0]
    return np.searchsorted(middles, elapsed - 1e-6 / header.fps).astype(np.int64)


def model_times(header: SequenceHeader, elapsed: Float) -> Float:
    """Return times ``(N,)`` of a model for times since its first one, clipped to its end."""
    inside = np.minimum(header.times[0] + elapsed, header.times[-1])
    # a curve has exactly the values of its knots at exactly their times
    nearest = header.times[nearest_frames(header, elapsed)]
    return np.where(np.abs(inside - nearest) < 1e-6 / header.fps, nearest, inside)
