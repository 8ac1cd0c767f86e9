"""Times at which any channel of a scene changes, merged into frames where they differ only by rounding."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mixseq.arrays import Float

SAME_TIME = 1e-6
"""Largest distance in seconds of keys of different channels that make one frame."""

MOST_PLAYED = 100_000
"""Largest number of frames added between keys; an hour has 86 400 at 24 frames per second."""

_EARLY = 2.0  # seconds; exporters compute earlier times from later ones


def joined(channels: Iterable[Float], tolerance: float = SAME_TIME) -> Float:
    """Return the times ``(n,)`` of all channels, increasing, merged if equal in two channels, but not within one."""
    times = np.empty(0)
    for each in channels:
        times = united(times, each, tolerance)
    return times


def united(times: Float, more: Float, tolerance: float | Float) -> Float:
    """Return times and `more` ``(n,)``, increasing, without those of `more` within `tolerance` of one of `times`."""
    ends = np.concatenate([[-np.inf], times, [np.inf]])
    place = np.searchsorted(times, more)
    near = np.minimum(more - ends[place], ends[place + 1] - more) <= tolerance
    return np.union1d(times, more[~near])


def on_grid(times: Float, fps: float) -> Float:
    """Return times ``(T,)``, moved to ``k / fps`` if within two float32 steps of it (of 2 s, for earlier times).

    Other times stay as they are, and all do where two would become one.

    Examples
    --------
    >>> rounded = np.array([0, 1 / 24, 49 / 48, 1.05], np.float32).astype(np.float64)
    >>> on_grid(rounded, 48).tolist() == [0, 1 / 24, 49 / 48, rounded[3]]
    True
    """
    with np.errstate(all="ignore"):  # non-finite times are reported where they are used
        nearest = np.rint(times * fps) / fps
        rounding = 2 * np.spacing(np.maximum(np.abs(times), _EARLY).astype(np.float32)).astype(np.float64)
        snapped = np.where(np.abs(nearest - times) <= rounding, nearest, times)
        return snapped if (np.diff(snapped) > 0).all() else times
