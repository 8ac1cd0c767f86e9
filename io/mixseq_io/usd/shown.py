"""USD, writing: which time of the file below a layer shows when.

A sublayer keeps its seconds, whatever the rate of the layer above. Where the whole stage is retimed, what moves in it
gets samples in the layer instead: its values at the times that the frames show. A layer offset would do for a constant
speed, forwards; samples do for ramps, pauses and backwards, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd

from mixseq.errors import SettingsError
from mixseq.sequence import SequenceHeader
from mixseq_io.usd.paths import time_codes


@dataclass(frozen=True, eq=False)
class Shown:
    """Which time codes of the file below those of a layer show.

    Parameters
    ----------
    rate_below, rate : float
        Time codes per second, of the file and of the layer.
    codes : (T,) float
        Time codes of the layer's frames.
    sources : (T,) float, optional
        Time of the file that each of them shows, in seconds; by default the same.
    """

    rate_below: float
    rate: float
    codes: NDArray[np.float64]
    sources: NDArray[np.float64] | None = None

    @property
    def start(self) -> float:
        """Time of the layer's first frame, in seconds."""
        return float(self.codes[0]) / self.rate

    def below(self, time: float) -> float:
        """Return the time code of the file that is shown at a time of the layer, in seconds."""
        if self.sources is None:
            return time * self.rate_below
        return float(np.interp(time * self.rate, self.codes, self.sources)) * self.rate_below

    def samples(self, attribute: Usd.Attribute) -> Iterator[tuple[float, Any]]:
        """Yield time codes of the layer, and what an attribute of the file that varies is then."""
        if self.sources is None:
            every = np.array(attribute.GetTimeSamples(), dtype=np.float64)
            codes = every * (self.rate / self.rate_below)
        else:
            codes, every = self.codes, self.sources * self.rate_below
        for code, below in zip(codes.tolist(), every.tolist(), strict=True):
            value = attribute.Get(Usd.TimeCode(below))
            yield code, Sdf.ValueBlock() if value is None else value


def shown_by(header: SequenceHeader, rate_below: float, sources: NDArray[np.float64] | None = None) -> Shown:
    """Return what the frames of a sequence show of a file with a rate.

    Raises
    ------
    SettingsError
        If there are more or fewer `sources` than frames, or one is not a time.
    """
    if sources is not None and not (sources.shape == header.times.shape and np.isfinite(sources).all()):
        raise SettingsError(
            f"sources are {np.isfinite(sources).sum()} times for {header.frame_count} frames; to retime the whole "
            "stage every frame must show a single time of the original"
        )
    return Shown(rate_below, header.fps, time_codes(header.times, header.fps), sources)
