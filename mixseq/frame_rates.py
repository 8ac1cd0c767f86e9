"""Frame rates of television: what people mean who type 23.976, and how rates are shown.

NTSC's rates are 1000/1001 of whole numbers, 24000/1001 = 23.976023... Typed numbers are rounded; taken as they are, a
shot that begins at frame 1001 is off by a thousandth of a frame at once, and no frame falls on another's grid.
"""

from __future__ import annotations

from math import isfinite

NTSC_RATES = tuple(1000 * whole / 1001 for whole in (24, 30, 48, 60, 120))

_ROUNDED = 0.005
"""A rate that is nearer to one of NTSC's than this is that one, rounded to two digits or more."""


def exact_rate(fps: float, own: float | None = None) -> float:
    """Return the frames per second that a typed number means.

    Examples
    --------
    >>> exact_rate(23.976) == 24000 / 1001, exact_rate(29.97) == 30000 / 1001, exact_rate(25.0)
    (True, True, 25.0)
    >>> exact_rate(47.952, own=23.976)
    47.952
    """
    if own and fps > 0 and isfinite(fps):
        times = max(fps / own, own / fps)
        if abs(times - round(times)) < 1e-9:
            return fps
    return next((rate for rate in NTSC_RATES if abs(fps - rate) < _ROUNDED), fps)


def rate_text(fps: float) -> str:
    """Return a rate in words; NTSC's exactly.

    Examples
    --------
    >>> rate_text(24000 / 1001), rate_text(25), rate_text(23.976)
    ('24000/1001 (23.976)', '25', '23.976')
    """
    for rate in NTSC_RATES:
        if abs(fps - rate) < 1e-9 * rate:
            return f"{round(1001 * rate)}/1001 ({rate:.3f})"
    return f"{fps:g}"
