"""USD, writing: map from a layer's time to the time of the file below.

A sublayer keeps its seconds at any rate of the layer above. When the whole stage is retimed, its moving attributes get
samples in the layer, taken at the times that the frames show; a layer offset suffices for constant speed forwards only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pxr import Sdf, Usd

from mixseq.errors import SettingsError
from mixseq.sequence import SequenceHeader
from mixseq_io.usd.paths import time_codes


@dataclass(frozen=True, eq=False)
class Shown:
    """Time codes of the file below, by those of a layer."""

    rate_below: float
    rate: float
    codes: NDArray[np.float64]
    sources: NDArray[np.float64] | None = None

    @property
    def start(self) -> float:
        """Time of the layer's first frame, in seconds."""
        return float(self.codes[0]) / self.rate

    def below(self, time: float) -> float:
        """Return the file's time code at a time of the layer, in seconds."""
        if self.sources is None:
            return time * self.rate_below
        return float(np.interp(time * self.rate, self.codes, self.sources)) * self.rate_below

    def samples(self, attribute: Usd.Attribute) -> Iterator[tuple[float, Any]]:
        """Yield the layer's time codes with the values of a varying attribute of the file."""
        if self.sources is None:
            every = np.array(attribute.GetTimeSamples(), dtype=np.float64)
            codes = every * (self.rate / self.rate_below)
        else:
            codes, every = self.codes, self.sources * self.rate_below
        for code, below in zip(codes.tolist(), every.tolist(), strict=True):
            value = attribute.Get(Usd.TimeCode(below))
            yield code, Sdf.ValueBlock() if value is None else value


def source_times(header: SequenceHeader, sources: ArrayLike) -> NDArray[np.float64]:
    """Return the times ``(T,)`` of the original that frames show, in seconds."""
    times = np.asarray(sources, dtype=np.float64)
    if times.shape != header.times.shape:
        raise SettingsError(
            f"sources are {times.size} times for {header.frame_count} frames; give one for every frame"
        )
    return times


def shown_by(header: SequenceHeader, rate_below: float, sources: NDArray[np.float64] | None = None) -> Shown:
    """Return the map from a sequence's frames to a file with a rate."""
    if sources is not None and not np.isfinite(sources).all():
        frame = int(np.argmin(np.isfinite(sources)))
        raise SettingsError(
            f"frame {frame} shows no single time of the original, so that the whole stage cannot be retimed; leave out "
            "whole_stage"
        )
    return Shown(rate_below, header.fps, time_codes(header.times, header.fps), sources)
