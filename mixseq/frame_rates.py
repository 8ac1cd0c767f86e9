"""Frame rates of television: exact values of typed rates such as 23.976, and their display.

NTSC rates are 1000/1001 of whole numbers, 24000/1001 = 23.976023... With the rounded value, a shot that begins at frame
1001 would be off by a thousandth of a frame, and frames would miss the grid.
"""

from __future__ import annotations

from math import isfinite

NTSC_RATES = tuple(1000 * whole / 1001 for whole in (24, 30, 48, 60, 120))

_ROUNDED = 0.005
"""Largest distance of a rounded rate from an NTSC rate: that of two digits or more."""


def exact_rate(fps: float, own: float | None = None) -> float:
    """Return the NTSC rate of a rounded one (23.976: 24000/1001); other rates and multiples of `own` stay."""
    if own and fps > 0 and isfinite(fps):
        times = max(fps / own, own / fps)
        if abs(times - round(times)) < 1e-9:
            return fps
    return next((rate for rate in NTSC_RATES if abs(fps - rate) < _ROUNDED), fps)


def rate_text(fps: float) -> str:
    """Format a rate, NTSC's exactly: "24000/1001 (23.976)"."""
    for rate in NTSC_RATES:
        if abs(fps - rate) < 1e-9 * rate:
            return f"{round(1001 * rate)}/1001 ({rate:.3f})"
    return f"{fps:g}"
