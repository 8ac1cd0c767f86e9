"""When samples are, and which of them a frame lies between.

Every Alembic property has samples of its own, at times in seconds: uniform, in cycles (several per shutter), or one by
one. Frames are the times at which something of the chosen meshes changes; what has no sample there is interpolated.

Specification: https://docs.alembic.io/reference/index.html (``TimeSampling``)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.errors import FormatError
from mixseq.sequence import DEFAULT_FPS

SAME_TIME = 0.999e-6
"""Times closer than this count once, in seconds."""

_MOST_SAMPLES = 1_000_000
_USUAL_RATES = (24, 25, 30, 48, 50, 60, 24000 / 1001, 30000 / 1001, 60000 / 1001, 100, 120, 240)


def sample_times(sampled: Any) -> Float:
    """Return the times ``(N,)`` in seconds of a property's or schema's samples.

    Raises
    ------
    FormatError
        If there are more than a million samples, or fewer times than samples.
    """
    count, sampling = sampled.getNumSamples(), sampled.getTimeSampling()
    if count > _MOST_SAMPLES:
        raise FormatError(f"a property claims {count} samples; the file is damaged")
    kind, stored = sampling.getTimeSamplingType(), np.array(list(sampling.getStoredTimes()), dtype=np.float64)
    sample = np.arange(count)
    if not kind.isAcyclic():
        per_cycle = kind.getNumSamplesPerCycle()
        cycle, sample = np.divmod(sample, max(per_cycle, 1))
    if sample.max(initial=-1) >= len(stored):
        raise FormatError(f"a property has {len(stored)} times for {count} samples; the file is damaged")
    return stored[sample] if kind.isAcyclic() else stored[sample] + cycle * kind.getTimePerCycle()


def merged(times: Sequence[Float]) -> Float:
    """Return all times in order, those that are the same once.

    Examples
    --------
    >>> merged([np.array([0.0, 0.5]), np.array([0.25, 0.5 + 1e-9])]).tolist()
    [0.0, 0.25, 0.5]
    """
    every = np.unique(np.concatenate(times))
    return every[np.diff(every, prepend=-np.inf) > SAME_TIME]


@dataclass(frozen=True, eq=False)
class Track:
    """Which samples every frame lies between.

    Parameters
    ----------
    before : (T,) int
        The sample at or before each frame; the first, for frames before it.
    weight : (T,) float
        Weight of the sample after it, from 0 to 1; 0 at and after the last.
    """

    before: NDArray[np.int64]
    weight: Float

    def at(self, frame: int) -> tuple[int, float]:
        """Return the sample before a frame, and the weight of the one after."""
        return int(self.before[frame]), float(self.weight[frame])

    @property
    def exact(self) -> bool:
        """Whether every frame has a sample of its own."""
        return not self.weight.any() and bool((np.diff(self.before) > 0).all())


def locate(own: Float, frames: Float) -> Track:
    """Find the samples, at the times `own`, that frames lie between.

    Examples
    --------
    >>> track = locate(np.array([1.0, 2.0]), np.array([0.0, 1.0, 1.25, 2.0, 3.0]))
    >>> track.before.tolist(), track.weight.tolist()
    ([0, 0, 0, 1, 1], [0.0, 0.0, 0.25, 0.0, 0.0])
    """
    before = np.clip(np.searchsorted(own, frames + SAME_TIME, side="right") - 1, 0, len(own) - 1)
    after = np.minimum(before + 1, len(own) - 1)
    since, step = frames - own[before], own[after] - own[before]
    weight = np.divide(since, step, out=np.zeros_like(since), where=(step > 0) & (since > SAME_TIME))
    return Track(before, weight)


def frame_rate(times: Float, declared: str) -> float:
    """Return the frames per second of a time line.

    Parameters
    ----------
    times : (T,) float
        The frames, in seconds.
    declared : str
        What the application says, "" for nothing. Frames need not be at its multiples.

    Examples
    --------
    >>> frame_rate(np.array([0.0, 1 / 29.97, 2 / 29.97]), "")
    29.97
    >>> frame_rate(np.array([0.0, 1 / 24, 4 / 24]), "")
    24.0
    """
    step = (times[-1] - times[0]) / max(len(times) - 1, 1)
    even = len(times) > 1 and np.allclose(np.diff(times), step, rtol=0, atol=1e-6 * step + 1e-9)
    rounding = float(np.spacing(np.abs(times).max())) / max(step, 1e-9)  # late times are less precise
    rate = _plain(1 / step, 1e-12 + rounding) if even else 0.0
    try:
        said = float(declared or 0)
    except ValueError:
        said = 0.0
    if (
        np.isfinite(said) and said > 0 and not np.isclose(said, rate, rtol=1e-6)
    ):  # else the step is more precise
        return _plain(said, 1e-8)
    for usual in () if even else _USUAL_RATES:
        if len(times) > 1 and np.allclose(times * usual, np.rint(times * usual), rtol=0, atol=1e-3):
            return float(usual)
    return rate or DEFAULT_FPS


def _plain(rate: float, tolerance: float) -> float:
    """Return the number that was meant, if it went through a reciprocal or a text: 29.97 or 30000/1001."""
    simple = float(Fraction(rate).limit_denominator(1001))
    return simple if np.isclose(simple, rate, rtol=tolerance, atol=0) else float(f"{rate:.12g}")
