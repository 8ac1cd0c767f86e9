"""The times at which something in a scene changes, of which its frames are made.

Every channel of an animation has key times of its own: attributes in USD, properties in Alembic, properties of nodes in
glTF. The frames of a sequence are at all of them, and times that differ by rounding only are one.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mixseq.arrays import Float

SAME_TIME = 1e-6
"""Keys of different channels that are not further apart than this, in seconds, make one frame."""

MOST_PLAYED = 100_000
"""More frames than this are not added between keys; an hour has 86 400 at 24 frames per second."""

_EARLY = 2.0  # seconds; exporters compute earlier times from later ones


def joined(channels: Iterable[Float], tolerance: float = SAME_TIME) -> Float:
    """Return the times of all channels, increasing; what is the same time in two channels counts once.

    Times within a channel differ on purpose, however close they are.

    Examples
    --------
    >>> joined([np.array([0.0, 0.5]), np.array([0.25, 0.5 + 1e-9])]).tolist()
    [0.0, 0.25, 0.5]
    """
    times = np.empty(0)
    for each in channels:
        times = united(times, each, tolerance)
    return times


def united(times: Float, more: Float, tolerance: float | Float) -> Float:
    """Return both, increasing, without those of `more` that are as near as `tolerance` to one of `times`.

    Shapes: times, more ``(n,)``.

    Examples
    --------
    >>> united(np.array([1.0, 2.0]), np.array([1.5, 2.0 + 1e-9]), 1e-6).tolist()
    [1.0, 1.5, 2.0]
    """
    ends = np.concatenate([[-np.inf], times, [np.inf]])
    place = np.searchsorted(times, more)
    near = np.minimum(more - ends[place], ends[place + 1] - more) <= tolerance
    return np.union1d(times, more[~near])


def on_grid(times: Float, fps: float) -> Float:
    """Return times ``(T,)``, those that are ``k / fps`` but for float32 rounding as exactly that.

    Rounding is up to two steps of float32 at the time, at 2 s where it is earlier. Times that do not fall on the grid
    stay as they are, and all do where two would become one.

    Examples
    --------
    >>> rounded = np.array([0, 1 / 24, 49 / 48, 1.05], np.float32).astype(np.float64)
    >>> on_grid(rounded, 48).tolist() == [0, 1 / 24, 49 / 48, rounded[3]]
    True
    """
    with np.errstate(all="ignore"):  # what is not finite is told where the times are used
        nearest = np.rint(times * fps) / fps
        rounding = 2 * np.spacing(np.maximum(np.abs(times), _EARLY).astype(np.float32)).astype(np.float64)
        snapped = np.where(np.abs(nearest - times) <= rounding, nearest, times)
        return snapped if (np.diff(snapped) > 0).all() else times
